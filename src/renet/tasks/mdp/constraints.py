"""Constraint costs of the cMDP: joint position, joint velocity, torque (RENet, Method A).

Each cost is a metric, such as `cost_joint_position`. `constraint_costs` collects them for the
learner in the order of interface.CONSTRAINTS. A cost is the sum over joints of the excess over a
limit, times the step's dt. It is zero for motion inside the limits, and for a state that is NaN or
infinite, which ends the episode.
"""

import torch
from mjlab.envs import ManagerBasedRlEnv
from mjlab.managers.metrics_manager import MetricsTermCfg
from mjlab.utils.lab_api.string import resolve_matching_names_values
from torch import Tensor

from renet.errors import RenetError
from renet.interface import CONSTRAINTS


def constraint_costs(env: ManagerBasedRlEnv) -> Tensor:
    """Collect the costs of the newest step, [N, 3], in the order of interface.CONSTRAINTS.

    Raises:
        RenetError: The task lacks a cost.
    """
    metrics = env.metrics_manager
    names = [f"cost_{name}" for name in CONSTRAINTS]
    if missing := [name for name in names if name not in metrics.active_terms]:
        raise RenetError(
            f"the task lacks the metrics {', '.join(missing)}: constraint costs are those of "
            "tasks built like renet.tasks"
        )
    values = metrics._step_values  # type: ignore[union-attr]
    columns = [metrics.active_terms.index(name) for name in names]
    return torch.stack([values[:, column] for column in columns], dim=-1)


class joint_position_cost:
    """Joint positions beyond the robot's soft limits, [N] rad s."""

    def __init__(self, cfg: MetricsTermCfg, env: ManagerBasedRlEnv) -> None:
        low, high = env.scene["robot"].data.soft_joint_pos_limits.unbind(-1)
        self._middle = (low + high) / 2
        self._half_range = (high - low) / 2

    def __call__(self, env: ManagerBasedRlEnv) -> Tensor:
        position = env.scene["robot"].data.joint_pos
        return _cost(env, (position - self._middle).abs() - self._half_range)


class joint_velocity_cost:
    """Joint velocities beyond a limit, [N] rad; a joint counts at most 1 rad/s.

    Parameters:
        limits: Limits by pattern of joint names, rad/s.
    """

    def __init__(self, cfg: MetricsTermCfg, env: ManagerBasedRlEnv) -> None:
        self._limits = _per_joint(env, cfg.params["limits"])

    def __call__(self, env: ManagerBasedRlEnv, limits: dict[str, float]) -> Tensor:
        velocity = env.scene["robot"].data.joint_vel
        return _cost(env, (velocity.abs() - self._limits).clamp_max(1.0))


class torque_cost:
    """Torques beyond a limit, [N] N m s.

    Torques are those of the servo's law with nominal gains, before the actuator saturates: a target
    out of the motor's reach costs more than one at its limit.

    Parameters:
        limits: Limits by pattern of joint names, N m.
        stiffness: Kp of every joint, N m/rad.
        damping: Kd of every joint, N m s/rad.
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
    """Return the limit of each joint, [J], from limits by pattern of joint names."""
    values = resolve_matching_names_values(limits, env.scene["robot"].joint_names)[2]
    return torch.tensor(values, device=env.device)


def _cost(env: ManagerBasedRlEnv, excess: Tensor) -> Tensor:
    """Compute the cost of a step, [N], from each joint's excess over its limit, [N, J]."""
    return (excess.relu().sum(-1) * env.step_dt).nan_to_num(0.0, 0.0, 0.0)
