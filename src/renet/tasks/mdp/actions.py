"""Joint-position actions in the order of interface.JOINTS, for any order in the robot's MJCF."""

import math
from dataclasses import dataclass

import torch
from mjlab.envs import ManagerBasedRlEnv
from mjlab.envs.mdp.actions import JointPositionAction, JointPositionActionCfg
from torch import Tensor

from renet.errors import RenetError
from renet.interface import JOINTS


@dataclass(kw_only=True)
class OrderedJointPositionActionCfg(JointPositionActionCfg):
    """Actions whose element i is the position target of joint i of interface.JOINTS."""

    actuator_names: tuple[str, ...] | list[str] = JOINTS
    target_rate: float = math.inf
    """Largest rate of change of a joint target, rad/s. If it is finite, targets also stay within
    the joints' ranges, as those of a real robot do (see `renet.deploy.safety`)."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.target_rate > 0.0:
            raise RenetError(f"actions.target_rate must be positive, got {self.target_rate}")

    def build(self, env: ManagerBasedRlEnv) -> "OrderedJointPositionAction":
        return OrderedJointPositionAction(self, env)


class OrderedJointPositionAction(JointPositionAction):
    """Joint-position action in the order of interface.JOINTS; mjlab's has the order of the MJCF.

    Policies observe their own action, not the target within the limits.
    """

    cfg: OrderedJointPositionActionCfg

    def __init__(self, cfg: OrderedJointPositionActionCfg, env: ManagerBasedRlEnv) -> None:
        super().__init__(cfg, env)
        data = self._entity.data
        self._start = data.default_joint_pos[:, self._target_ids].clone()
        self._target = self._start.clone()
        """Newest joint targets, [N, 12] rad."""
        ranges = data.joint_pos_limits[:, self._target_ids]
        self._lower = ranges[..., 0]
        self._upper = ranges[..., 1]

    def _find_targets(self, cfg: OrderedJointPositionActionCfg) -> tuple[list[int], list[str]]:  # type: ignore[override]
        return self._entity.find_joints(cfg.actuator_names, preserve_order=True)

    def process_actions(self, actions: Tensor) -> None:
        """Compute joint targets within the configured limits from actions [N, 12]."""
        super().process_actions(actions)
        if not math.isfinite(self.cfg.target_rate):
            return
        reach = self.cfg.target_rate * self._env.step_dt
        target = torch.clamp(self._processed_actions, self._target - reach, self._target + reach)
        self._target = torch.clamp(target, self._lower, self._upper)
        self._processed_actions = self._target

    def reset(self, env_ids: Tensor | slice | None = None) -> None:
        """Reset targets to the default pose, in which a robot stands before it walks."""
        super().reset(env_ids)
        self._target[env_ids] = self._start[env_ids]
