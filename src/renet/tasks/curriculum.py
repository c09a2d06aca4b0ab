"""Terrain levels (walk-in-minutes rule) and the two-level command curriculum."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
import warp as wp
from torch import Tensor
from torch.nn.functional import one_hot

from renet.tasks.commands import goal
from renet.tasks.step import Step
from renet.tasks.terminations import HALF_TILE, from_middle
from renet.tasks.terms import Launch

if TYPE_CHECKING:
    from mjlab.envs import ManagerBasedRlEnv

    from renet.tasks.env import RenetEnv

# Warp compiles annotations and arithmetic that pyright takes for Python's.
# pyright: reportGeneralTypeIssues=false, reportInvalidTypeForm=false, reportOperatorIssue=false

FIRST_LEVELS = 2
"""A robot that fails at the first level tries one of so many next. The narrowest gap is all but
invisible (10 cm, seen from 30 cm above through the camera's noise): where all robots start over at
it, VP never learns what a gap looks like."""


@wp.kernel(enable_backward=False)
def change_levels(
    step: Step,
    ended: wp.array(dtype=wp.bool),
    asked: wp.array(dtype=float),
    failed: wp.array(dtype=wp.bool),
    draws: wp.array2d(dtype=wp.int64),
    starts: wp.array2d(dtype=wp.vec3),
    levels: wp.array(dtype=wp.int64),
):
    """Who moves up and who moves down (Rudin et al. 2022), and where each of them starts.

    Up when half a tile lies behind, down below half of what was commanded (no more than half a tile
    can be covered, whatever the command). A robot that fell owes the whole episode, lest falling
    early look like keeping up; one that was cut off, as in a run's first, randomly shortened
    episodes, owes what it had time for. One that has not walked, as after loading a checkpoint, may
    stand on any other tile.

    Args:
        ended: [N], others stay where they are. asked: [N] m the commands amount to so far.
        failed: [N]. draws: [N, 2] random levels after failing at the first and passing the last.
        starts: [levels, kinds]. levels: [N], changed in place.
    """
    robot = wp.tid()
    if not ended[robot]:
        return
    level = int(levels[robot])
    if step.length[robot] > wp.int64(0):
        owed = asked[robot]
        if failed[robot]:
            left = wp.max(step.longest - int(step.length[robot]), 0)
            owed += step.speed[robot] * float(left) * step.dt
        distance = from_middle(step, robot)  # type: ignore[arg-type]
        if distance > HALF_TILE:
            level += 1
        elif distance < 0.5 * wp.min(owed, HALF_TILE):
            level -= 1
    if level < 0:
        level = int(draws[robot, 0])
    if level >= starts.shape[0]:
        level = int(draws[robot, 1])
    levels[robot] = wp.int64(level)
    step.origin[robot] = starts[level, int(step.tile[robot])]


class TerrainLevels:
    """Moves robots between rows; the mean level of each kind of tile is logged."""

    def __init__(self, cfg, env: RenetEnv) -> None:
        del cfg
        terrain = env.scene.terrain
        assert terrain is not None
        assert terrain.cfg.terrain_generator is not None
        self.kinds = list(terrain.cfg.terrain_generator.sub_terrains)
        here = one_hot(terrain.terrain_types, len(self.kinds))
        self._share = here / here.sum(0).clamp_min(1)
        """What each robot counts in each kind's mean, [N, kinds]."""
        self._levels = terrain.terrain_levels
        self._ended = torch.zeros(env.num_envs, dtype=torch.bool, device=env.device)
        self._draws = torch.zeros(env.num_envs, 2, dtype=torch.long, device=env.device)
        assert terrain.terrain_origins is not None
        starts = wp.from_torch(terrain.terrain_origins.contiguous(), dtype=wp.vec3)
        self._last = len(terrain.terrain_origins)
        asked, failed = goal(env).asked, env.termination_manager.terminated
        inputs = [env.watched, self._ended, asked, failed, self._draws, starts, self._levels]
        self._change = Launch(change_levels, env.num_envs, inputs, env.device)

    def __call__(self, env: ManagerBasedRlEnv, env_ids: Tensor) -> dict[str, Tensor]:
        """Move the robots in `env_ids`, whose episodes end."""
        del env
        self._ended.zero_()
        self._ended[env_ids] = True
        self._draws[:, 0].random_(FIRST_LEVELS)
        self._draws[:, 1].random_(self._last)
        self._change()
        means = self._levels.float() @ self._share
        return dict(zip(self.kinds, means.unbind(), strict=True))


def command_stage(env: ManagerBasedRlEnv, env_ids: Tensor, switch_step: int) -> Tensor:
    """Ask for standing still, too, once `switch_step` control steps have been taken."""
    del env_ids
    command = goal(env)
    if env.common_step_counter >= switch_step:
        command.stage = 1
    return torch.tensor(float(command.stage))
