"""Constraint costs of the cMDP: joint position, joint velocity, torque (RENet, Method A).

Each is zero for motion inside its soft limit. The cost of joint positions is mjlab's
`joint_pos_limits`.
"""

from __future__ import annotations

import torch
from mjlab.envs import ManagerBasedRlEnv
from mjlab.managers.metrics_manager import MetricsTermCfg
from mjlab.utils.lab_api.string import resolve_matching_names_values
from torch import Tensor

from renet.interface import CONSTRAINTS


def joint_vel_limits(env: ManagerBasedRlEnv, limit: Tensor) -> Tensor:
    """Sum over joints of the speed beyond a limit, at most 1 rad/s of each, [N] rad/s.

    Args:
        env: the environment.
        limit: speed above which a joint costs, [J] rad/s.
    """
    speed = env.scene["robot"].data.joint_vel.abs()
    return (speed - limit).clamp(0.0, 1.0).sum(-1)


def torque_limits(
    env: ManagerBasedRlEnv, limit: Tensor, stiffness: float, damping: float
) -> Tensor:
    """Sum over joints of the torque beyond a limit, [N] N m.

    It is the torque that the nominal gains ask for, before the actuator saturates: clipped torque
    never violates anything.

    Args:
        env: the environment.
        limit: torque above which a joint costs, [J] N m.
        stiffness: Kp, N m/rad.
        damping: Kd, N m s/rad.
    """
    data = env.scene["robot"].data
    torque = stiffness * (data.joint_pos_target - data.joint_pos) - damping * data.joint_vel
    return torch.relu(torque.abs() - limit).sum(-1)


class constraint_violated:
    """Metric: 1 where a constraint costs something in this step, [N].

    Writes the cost times the step's dt into its column of `env.extras["costs"]`, [N, 3] in the
    order of interface.CONSTRAINTS, where the learner reads it. Costs of broken physics are zero.
    """

    def __init__(self, cfg: MetricsTermCfg, env: ManagerBasedRlEnv) -> None:
        params = dict(cfg.params)
        self._column = CONSTRAINTS.index(params.pop("constraint"))
        self._cost = params.pop("cost")
        if "limit" in params:  # By pattern of joint names.
            names = env.scene["robot"].joint_names
            _, _, limit = resolve_matching_names_values(params["limit"], names)
            params["limit"] = torch.tensor(limit, device=env.device)
        self._params = params
        shape = env.num_envs, len(CONSTRAINTS)
        env.extras.setdefault("costs", torch.zeros(shape, device=env.device))

    def __call__(self, env: ManagerBasedRlEnv, **_: object) -> Tensor:
        """Evaluate the cost of the present state."""
        cost = self._cost(env, **self._params).nan_to_num(0.0, 0.0, 0.0)
        env.extras["costs"][:, self._column] = cost * env.step_dt
        return (cost > 0.0).float()
