"""Constraint costs of the cMDP: joint position, joint velocity, torque (RENet, Method A).

Each cost is a metric of its own, `cost_joint_position` and so on, which `constraint_costs` puts in
the order of interface.CONSTRAINTS for the learner. A cost is the sum over joints of what is beyond
a limit, times the step's dt: zero for motion inside the limits, and for broken physics.
"""

import torch
from mjlab.envs import ManagerBasedRlEnv
from mjlab.managers.metrics_manager import MetricsTermCfg
from mjlab.utils.lab_api.string import resolve_matching_names_values
from torch import Tensor

from renet.errors import RenetError
from renet.interface import CONSTRAINTS


def constraint_costs(env: ManagerBasedRlEnv) -> Tensor:
    """Costs of the newest step, [N, 3] as interface.CONSTRAINTS; raises RenetError without them."""
    metrics = env.metrics_manager
    names = [f"cost_{name}" for name in CONSTRAINTS]
    if missing := [name for name in names if name not in metrics.active_terms]:
        raise RenetError(
            f"the task lacks the metrics {', '.join(missing)}: constraint costs are those of "
            "tasks built like renet.tasks"
        )
    values = metrics._step_values  # type: ignore[union-attr]
    return torch.stack([values[:, metrics.active_terms.index(name)] for name in names], dim=-1)


class joint_position_cost:
    """Joint positions beyond the robot's soft limits, [N] rad s."""

    def __init__(self, cfg: MetricsTermCfg, env: ManagerBasedRlEnv) -> None:
        low, high = env.scene["robot"].data.soft_joint_pos_limits.unbind(-1)
        self._middle, self._reach = (low + high) / 2, (high - low) / 2

    def __call__(self, env: ManagerBasedRlEnv) -> Tensor:
        position = env.scene["robot"].data.joint_pos
        return _cost(env, (position - self._middle).abs() - self._reach)


class joint_velocity_cost:
    """Joint velocities beyond a limit, each joint at most 1 rad/s, [N] rad.

    Parameters: `limits`, rad/s by pattern of joint names.
    """

    def __init__(self, cfg: MetricsTermCfg, env: ManagerBasedRlEnv) -> None:
        self._limits = _per_joint(env, cfg.params["limits"])

    def __call__(self, env: ManagerBasedRlEnv, limits: dict[str, float]) -> Tensor:
        velocity = env.scene["robot"].data.joint_vel
        return _cost(env, (velocity.abs() - self._limits).clamp_max(1.0))


class torque_cost:
    """Torques beyond a limit, [N] N m s.

    They are what the nominal gains ask for, before the actuator saturates: a servo that asks for
    more than it gets wears out, too.

    Parameters: `limits`, N m by pattern of joint names; `stiffness` and `damping`, N m/rad and
    N m s/rad.
    """

    def __init__(self, cfg: MetricsTermCfg, env: ManagerBasedRlEnv) -> None:
        self._limits = _per_joint(env, cfg.params["limits"])

    def __call__(
        self, env: ManagerBasedRlEnv, limits: dict[str, float], stiffness: float, damping: float
    ) -> Tensor:
        data = env.scene["robot"].data
        torque = stiffness * (data.joint_pos_target - data.joint_pos) - damping * data.joint_vel
        return _cost(env, torque.abs() - self._limits)


def _per_joint(env: ManagerBasedRlEnv, limits: dict[str, float]) -> Tensor:
    values = resolve_matching_names_values(limits, env.scene["robot"].joint_names)[2]
    return torch.tensor(values, device=env.device)


def _cost(env: ManagerBasedRlEnv, excess: Tensor) -> Tensor:
    """Cost of a step [N], from what each joint is beyond its limit [N, J]."""
    return (excess.relu().sum(-1) * env.step_dt).nan_to_num(0.0, 0.0, 0.0)
