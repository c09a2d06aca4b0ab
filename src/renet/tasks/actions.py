"""Joint-position actions in the interface's order, whatever the order of the robot's MJCF."""

from __future__ import annotations

from dataclasses import dataclass

from mjlab.envs import ManagerBasedRlEnv
from mjlab.envs.mdp.actions import JointPositionAction, JointPositionActionCfg

from renet.interface import JOINTS


@dataclass(kw_only=True)
class JointTargetCfg(JointPositionActionCfg):
    """Action i moves joint i of interface.JOINTS."""

    actuator_names: tuple[str, ...] | list[str] = JOINTS

    def build(self, env: ManagerBasedRlEnv) -> JointTarget:
        """Instantiate the term."""
        return JointTarget(self, env)


class JointTarget(JointPositionAction):
    """mjlab's own keeps the order of the MJCF."""

    def _find_targets(self, cfg: JointTargetCfg) -> tuple[list[int], list[str]]:  # type: ignore[override]
        return self._entity.find_joints(cfg.actuator_names, preserve_order=True)
