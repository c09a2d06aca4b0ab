"""The goal: a forward speed c_x and a world yaw c_yaw, sampled at random (RENet, Method C)."""

# Warp compiles annotations and arithmetic that pyright takes for Python's.
# pyright: reportGeneralTypeIssues=false, reportInvalidTypeForm=false, reportArgumentType=false

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import torch
import warp as wp
from mjlab.entity import Entity
from mjlab.managers.command_manager import CommandTerm, CommandTermCfg
from mjlab.utils.lab_api.math import wrap_to_pi
from torch import Tensor

from renet.tasks.step import COMMAND, Step, heading
from renet.tasks.terms import Launch

if TYPE_CHECKING:
    from mjlab.envs import ManagerBasedRlEnv


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
    standing_share: float = 0.3
    """Share of stage 1's redrawn goals with c_x = 0: a uniform draw alone would never ask for it.
    None at an episode's start: to stop is harder than to stand."""
    slowest: float = 0.1
    """Smaller c_x mean standing still, m/s: eq. 6 divides by c_x, and sensor noise hides them."""
    first_turn: float = math.pi / 2
    """|c_yaw - yaw| at an episode's start is uniform up to this, rad."""
    later_turn: float = math.pi / 3
    """Largest change of c_yaw when a goal is redrawn, rad: a robot on a tile keeps leaving it."""
    fixed_speed: float | None = None
    """c_x for evaluation, m/s; c_yaw then stays each robot's starting yaw."""

    def build(self, env: ManagerBasedRlEnv) -> GoalCommand:
        """Instantiate the term."""
        return GoalCommand(self, env)

    def ranges(self, stage: int) -> tuple[float, float, float, float, float, float]:
        """What `pursue` draws from at a stage: see there."""
        if self.fixed_speed is not None:
            return (self.fixed_speed, self.fixed_speed, 0.0, 0.0, 0.0, 0.0)
        if stage == 0:
            return (*self.speed, 0.0, 0.0, self.first_turn, self.later_turn)
        standing = (self.standing_share, self.slowest)
        return (*self.later_speed, *standing, self.first_turn, self.later_turn)


class GoalCommand(CommandTerm):
    """Holds c_x and c_yaw; `command` is (c_x, sin, cos of the heading error), [N, 3].

    All robots' goals are drawn by one kernel, without asking the device whose time is up. Those of
    robots that begin an episode are drawn by the `compute` after it, where their yaw is known.
    """

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
        self._draws = torch.zeros(self.num_envs, 4, device=self.device)
        self._ranges: tuple[float, ...] = ()
        self._range = torch.zeros(8, device=self.device)
        self._pursue: dict[float, Launch] = {}

    def reset(self, env_ids: Tensor | slice | None) -> dict[str, float]:
        """Leave these robots without a goal."""
        ids = slice(None) if env_ids is None else env_ids
        self.asked[ids] = self.time_left[ids] = 0.0
        return {}

    def compute(self, dt: float | Tensor, env_ids: Tensor | None = None) -> None:
        """See CommandTerm.compute: zero in a tensor `dt` belongs to robots that begin."""
        del env_ids
        seconds = self._env.step_dt if isinstance(dt, Tensor) else dt
        ranges = (*self.cfg.ranges(self.stage), *self.cfg.resampling_time_range)
        if ranges != self._ranges:
            self._ranges = ranges
            self._range.copy_(torch.tensor(ranges))
        if seconds not in self._pursue:
            watched: Any = self._env.watched  # type: ignore[attr-defined]
            inputs = [watched, seconds, self._range, self._draws, self.time_left, self.asked]
            self._pursue[seconds] = Launch(pursue, self.num_envs, inputs, self.device)
        self._draws.uniform_()
        self._pursue[seconds]()

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

    # mjlab's steps of `compute`, which `pursue` takes.

    def _update_metrics(self) -> None: ...

    def _resample_command(self, env_ids: Tensor) -> None: ...

    def _update_command(self, env_ids: Tensor | None) -> None: ...


def goal(env: ManagerBasedRlEnv) -> GoalCommand:
    """The task's command term."""
    return env.command_manager.get_term(COMMAND)  # type: ignore[return-value]


@wp.kernel(enable_backward=False)
def pursue(
    step: Step,
    seconds: float,
    ranges: wp.array(dtype=float),
    draws: wp.array2d(dtype=float),
    time_left: wp.array(dtype=float),
    asked: wp.array(dtype=float),
):
    """Let time pass, draw goals where it is up, and tell all robots how far they are from theirs.

    Args:
        ranges: slowest and fastest c_x, m/s; share of redrawn goals that ask for standing; c_x
            below which all do; largest turn at an episode's start and later, rad; seconds between
            goals.
        draws: [N, 4] from [0, 1).
        time_left: [N] s, zero where an episode begins.
        asked: [N] m.
    """
    robot = wp.tid()
    now = heading(step, robot)
    origin = step.yaw[robot]
    turn = ranges[5]
    standing = ranges[2]
    if time_left[robot] <= 0.0:
        origin = now
        turn = ranges[4]
        standing = 0.0
    else:
        asked[robot] = asked[robot] + step.speed[robot] * seconds
        time_left[robot] = time_left[robot] - seconds
    if time_left[robot] <= 0.0:
        speed = ranges[0] + (ranges[1] - ranges[0]) * draws[robot, 0]
        stands = draws[robot, 1] < standing or speed < ranges[3]
        step.speed[robot] = wp.where(stands, 0.0, speed)
        aim = origin + turn * (2.0 * draws[robot, 2] - 1.0)
        step.yaw[robot] = wp.atan2(wp.sin(aim), wp.cos(aim))
        time_left[robot] = ranges[6] + (ranges[7] - ranges[6]) * draws[robot, 3]
    error = step.yaw[robot] - now
    step.command[robot, 0] = step.speed[robot]
    step.command[robot, 1] = wp.sin(error)
    step.command[robot, 2] = wp.cos(error)
