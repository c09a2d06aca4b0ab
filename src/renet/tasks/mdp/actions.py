"""Joint-position actions in the interface's order, whatever the order of the robot's MJCF."""

from dataclasses import dataclass

from mjlab.envs import ManagerBasedRlEnv
from mjlab.envs.mdp.actions import JointPositionAction, JointPositionActionCfg

from renet.interface import JOINTS


@dataclass(kw_only=True)
class OrderedJointPositionActionCfg(JointPositionActionCfg):
    """Action i is the position target of joint i of interface.JOINTS."""

    actuator_names: tuple[str, ...] | list[str] = JOINTS

    def build(self, env: ManagerBasedRlEnv) -> "OrderedJointPositionAction":
        return OrderedJointPositionAction(self, env)


class OrderedJointPositionAction(JointPositionAction):
    """mjlab's JointPositionAction keeps the order of the MJCF instead."""

    def _find_targets(self, cfg: OrderedJointPositionActionCfg) -> tuple[list[int], list[str]]:  # type: ignore[override]
        return self._entity.find_joints(cfg.actuator_names, preserve_order=True)
