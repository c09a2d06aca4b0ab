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
    resampling_time_range: tuple[float, float] = (2.0, 8.0)
    """Seconds between goals. Most robots have left their tile after 7 s: with later changes they
    learn to stand, but not to stop."""
    speed: tuple[float, float] = (0.2, 1.0)
    """Range of c_x in m/s at stage 0 (paper's first level)."""
    later_speed: tuple[float, float] = (0.0, 1.0)
    """Range of c_x at stage 1 (paper's second level)."""
    standing_share: float = 0.2
    """Share of stage 1's goals with c_x = 0: a uniform draw alone would never ask for it."""
    slowest: float = 0.1
    """Smaller c_x mean standing still, m/s: eq. 6 divides by c_x, and sensor noise hides them."""
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
        self.asked = torch.zeros(self.num_envs, device=self.device)
        """Metres a robot should have walked in its episode so far: the integral of c_x, [N]."""
        self._command = torch.zeros(self.num_envs, 3, device=self.device)

    def reset(self, env_ids: Tensor | slice | None) -> dict[str, float]:
        """See CommandTerm.reset."""
        self.asked[slice(None) if env_ids is None else env_ids] = 0.0
        return super().reset(env_ids)

    def compute(self, dt: float | Tensor, env_ids: Tensor | None = None) -> None:
        """See CommandTerm.compute."""
        if env_ids is None:
            self.asked += self.speed * dt
        super().compute(dt, env_ids)

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
        first = self.command_counter[env_ids] == 0
        if self.cfg.fixed is not None:
            speed, yaw = self.cfg.fixed
            self.speed[env_ids] = speed
            start = (
                self._spawn_yaw(env_ids) if yaw is None else torch.full_like(self.yaw[env_ids], yaw)
            )
            self.yaw[env_ids] = torch.where(first, start, self.yaw[env_ids])
            return
        self.speed[env_ids] = self._draw_speed(count)
        origin = torch.where(first, self._spawn_yaw(env_ids), self.yaw[env_ids])
        reach = torch.where(first, self.cfg.first_turn, self.cfg.later_turn)
        self.yaw[env_ids] = wrap_to_pi(origin + reach * self._uniform(count, -1.0, 1.0))

    def _draw_speed(self, count: int) -> Tensor:
        """c_x of new goals at the current stage, [count] m/s."""
        if self.stage == 0:
            return self._uniform(count, *self.cfg.speed)
        speed = self._uniform(count, *self.cfg.later_speed)
        standing = self._uniform(count, 0.0, 1.0) < self.cfg.standing_share
        return torch.where(standing | (speed < self.cfg.slowest), 0.0, speed)

    def _uniform(self, count: int, low: float, high: float) -> Tensor:
        return torch.empty(count, device=self.device).uniform_(low, high)

    def _spawn_yaw(self, env_ids: Tensor) -> Tensor:
        """Yaw in the state just written: derived poses still show the last episode's end."""
        address = self.robot.indexing.free_joint_q_adr
        w, x, y, z = self.robot.data.data.qpos[env_ids][:, address[3:7]].unbind(-1)
        return torch.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))

    def _update_command(self, env_ids: Tensor | None) -> None:
        del env_ids  # The error follows from the current heading everywhere.
        error = self.yaw - self.robot.data.heading_w  # Sine and cosine need no wrapping.
        torch.stack((self.speed, error.sin(), error.cos()), dim=-1, out=self._command)
