"""Constraint costs of the cMDP: joint position, joint velocity, torque (RENet, Method A).

Each is zero for motion inside its soft limit.
"""

from __future__ import annotations

import torch
from mjlab.envs import ManagerBasedRlEnv
from mjlab.managers.metrics_manager import MetricsTermCfg
from mjlab.utils.lab_api.string import resolve_matching_names_values
from torch import Tensor

from renet.interface import CONSTRAINTS


class constraint_costs:
    """Metric: 1 where any constraint costs something in this step, [N].

    Writes the costs times the step's dt into `env.extras["costs"]`, [N, 3] in the order of
    interface.CONSTRAINTS, where the learner reads them. They are sums over joints of what is beyond
    a limit, in rad, rad/s (each joint counts at most 1) and N m. Positions are limited by the
    robot's soft limits. Torque is what the nominal gains ask for, before the actuator saturates:
    clipped torque never violates anything. Broken physics costs nothing.

    Parameters: `joint_vel_limit` and `torque_limit`, rad/s and N m above which a joint costs, by
    pattern of joint names; `stiffness` and `damping`, N m/rad and N m s/rad.
    """

    def __init__(self, cfg: MetricsTermCfg, env: ManagerBasedRlEnv) -> None:
        robot = env.scene["robot"]
        low, high = robot.data.soft_joint_pos_limits.unbind(-1)
        self._middle, self._reach = (low + high) / 2, (high - low) / 2

        def per_joint(limit: dict[str, float]) -> Tensor:
            values = resolve_matching_names_values(limit, robot.joint_names)[2]
            return torch.tensor(values, device=env.device)

        self._joint_vel_limit = per_joint(cfg.params["joint_vel_limit"])
        self._torque_limit = per_joint(cfg.params["torque_limit"])
        env.extras["costs"] = torch.zeros(env.num_envs, len(CONSTRAINTS), device=env.device)

    def __call__(
        self, env: ManagerBasedRlEnv, stiffness: float, damping: float, **_: object
    ) -> Tensor:
        """Evaluate the present state."""
        data = env.scene["robot"].data
        position, velocity = data.joint_pos, data.joint_vel
        torque = stiffness * (data.joint_pos_target - position) - damping * velocity
        beyond = (
            (position - self._middle).abs() - self._reach,
            (velocity.abs() - self._joint_vel_limit).clamp_max(1.0),
            torque.abs() - self._torque_limit,
        )
        costs = torch.stack(beyond, dim=1).relu().sum(-1) * env.step_dt
        costs.nan_to_num_(0.0, 0.0, 0.0)
        env.extras["costs"].copy_(costs)
        return (costs > 0.0).any(-1).float()


def constraint_violated(env: ManagerBasedRlEnv, constraint: str) -> Tensor:
    """1 where a constraint costs something in this step, [N].

    Args:
        env: environment whose metrics have `constraint_costs` before this term.
        constraint: of interface.CONSTRAINTS.
    """
    return (env.extras["costs"][:, CONSTRAINTS.index(constraint)] > 0.0).float()
