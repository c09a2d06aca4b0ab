"""The goal: a forward speed c_x and a world yaw c_yaw, sampled at random (RENet, Method C)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from mjlab.entity import Entity
from mjlab.managers.command_manager import CommandTerm, CommandTermCfg
from mjlab.utils.lab_api.math import wrap_to_pi
from torch import Tensor

if TYPE_CHECKING:
    from mjlab.envs import ManagerBasedRlEnv

COMMAND = "goal"
"""Name of the command term in every RENet task."""


@dataclass(kw_only=True)
class GoalCommandCfg(CommandTermCfg):
    """How goals are drawn."""

    entity_name: str = "robot"
    resampling_time_range: tuple[float, float] = (8.0, 12.0)
    """Seconds between goals."""
    speed: tuple[float, float] = (0.2, 1.0)
    """Range of c_x in m/s while walking (paper's first level)."""
    standing_share: float = 0.1
    """Share of goals with c_x = 0 once `stage` is 1 (paper's second level is [0, 1.0])."""
    first_turn: float = math.pi / 2
    """|c_yaw - yaw| at an episode's start is uniform up to this, rad."""
    later_turn: float = math.pi / 3
    """Largest change of c_yaw when a goal is redrawn, rad: a robot on a tile keeps leaving it."""
    fixed: tuple[float, float | None] | None = None
    """(c_x, c_yaw) for evaluation; c_yaw None keeps each robot's starting yaw."""

    def build(self, env: ManagerBasedRlEnv) -> GoalCommand:
        """Instantiate the term."""
        return GoalCommand(self, env)


class GoalCommand(CommandTerm):
    """Holds c_x and c_yaw; `command` is (c_x, sin, cos of the heading error), [N, 3]."""

    cfg: GoalCommandCfg

    def __init__(self, cfg: GoalCommandCfg, env: ManagerBasedRlEnv) -> None:
        super().__init__(cfg, env)
        self.robot: Entity = env.scene[cfg.entity_name]
        self.stage = 0
        """0: walk only; 1: standing still is asked for too (paper's two-level curriculum)."""
        self.speed = torch.zeros(self.num_envs, device=self.device)
        """c_x, [N] m/s."""
        self.yaw = torch.zeros(self.num_envs, device=self.device)
        """c_yaw, [N] rad, world frame."""
        self._command = torch.zeros(self.num_envs, 3, device=self.device)

    @property
    def command(self) -> Tensor:
        """(c_x, sin e, cos e) with e = c_yaw - yaw, [N, 3]."""
        return self._command

    @property
    def heading_error(self) -> Tensor:
        """c_yaw - yaw, wrapped, [N] rad."""
        return wrap_to_pi(self.yaw - self.robot.data.heading_w)

    @property
    def direction(self) -> Tensor:
        """n_yaw = (cos c_yaw, sin c_yaw), [N, 2] (RENet eq. 6)."""
        return torch.stack((self.yaw.cos(), self.yaw.sin()), dim=-1)

    def _update_metrics(self) -> None:
        pass

    def _resample_command(self, env_ids: Tensor) -> None:
        count = len(env_ids)
        draw = torch.empty(count, device=self.device)
        first = self.command_counter[env_ids] == 0
        if self.cfg.fixed is not None:
            speed, yaw = self.cfg.fixed
            self.speed[env_ids] = speed
            start = self._spawn_yaw(env_ids) if yaw is None else torch.full_like(draw, yaw)
            self.yaw[env_ids] = torch.where(first, start, self.yaw[env_ids])
            return
        speed = draw.uniform_(*self.cfg.speed).clone()
        standing = draw.uniform_(0.0, 1.0) < self.cfg.standing_share
        self.speed[env_ids] = torch.where(standing & (self.stage > 0), 0.0, speed)
        origin = torch.where(first, self._spawn_yaw(env_ids), self.yaw[env_ids])
        reach = torch.where(first, self.cfg.first_turn, self.cfg.later_turn)
        self.yaw[env_ids] = wrap_to_pi(origin + reach * draw.uniform_(-1.0, 1.0))

    def _spawn_yaw(self, env_ids: Tensor) -> Tensor:
        """Yaw in the state just written: derived poses still show the last episode's end."""
        address = self.robot.indexing.free_joint_q_adr
        w, x, y, z = self.robot.data.data.qpos[env_ids][:, address[3:7]].unbind(-1)
        return torch.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))

    def _update_command(self, env_ids: Tensor | None) -> None:
        del env_ids  # The error follows from the current heading everywhere.
        error = self.heading_error
        self._command[:, 0] = self.speed
        self._command[:, 1] = error.sin()
        self._command[:, 2] = error.cos()
