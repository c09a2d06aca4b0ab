"""Terrain levels (walk-in-minutes rule), the two-level command curriculum, rewards' weights.

Whatever changes with time counts environment steps of all robots and processes; `EnvironmentSteps`
is the one place that knows how many are done.
"""

import os

import torch
from mjlab.envs import ManagerBasedRlEnv
from mjlab.managers.curriculum_manager import CurriculumTermCfg
from torch import Tensor

from renet.errors import RenetError
from renet.tasks.mdp.barriers import has_barriers
from renet.tasks.mdp.base_state import distance_from_start, on_tiles, tile_terrain
from renet.tasks.mdp.commands import goal
from renet.tasks.schedule import Schedule, value_at
from renet.terrain.tiles import BARRIERS, LEVELS, TILE

FIRST_LEVELS = 2
"""A robot that fails at the first level tries one of so many next. The narrowest gap is all but
invisible (10 cm, seen from 30 cm above through the camera's noise): where all robots start over at
it, VP never learns what a gap looks like."""


class EnvironmentSteps:
    """Environment steps of all robots and processes since training began."""

    def __init__(self, cfg: CurriculumTermCfg, env: ManagerBasedRlEnv) -> None:
        self._env = env
        self._robots = env.num_envs * int(os.getenv("WORLD_SIZE", "1"))
        self._offset = 0
        """Steps that a resumed run took with another number of robots."""

    def __call__(self, env: ManagerBasedRlEnv, env_ids: Tensor) -> Tensor:
        return torch.tensor(float(self.count))

    @property
    def count(self) -> int:
        """Steps that are done."""
        return self._offset + self._env.common_step_counter * self._robots

    @count.setter
    def count(self, steps: int) -> None:
        self._offset += steps - self.count


def environment_steps(env: ManagerBasedRlEnv) -> int:
    """Environment steps of all robots and processes that are done, in this run and before."""
    return env.curriculum_manager.get_term_cfg("environment_steps").func.count  # type: ignore[union-attr]


class TerrainLevels:
    """Move robots whose episodes end up or down a level (Rudin et al. 2022).

    Up when half a tile lies behind, down below half of what was commanded (no more than half a tile
    can be covered, whatever the command). A flat first level is for robots that cannot walk yet:
    failing does not lead back to it, or most steps would go to flat ground, where episodes last
    longest. A robot that fell owes the whole episode, lest falling early look like keeping up; one
    that was cut off, as in a run's first, randomly shortened episodes, owes what it had time for.
    One that has not walked keeps its level, as after loading a checkpoint. A robot that passes the
    last level is sent to any level. Whoever is among walls or on a ledge, which nobody can leave,
    is always sent to any level.

    Of the episodes on kinds of tile of `easier_kinds` a share, `easier_share`, use a tile of a
    level drawn uniformly up to the robot's own, from the lowest `easier_levels`. They do not change
    that level. Without them robots forget how to cross narrow gaps. Share and levels follow
    schedules; all three are parameters.

    Attributes:
        levels: each robot's own level, [N]; `terrain.terrain_levels` is that of the tile it is on.
        passed: robots that passed the last level and have not failed since, [N] bool. They count
            as having reached the number of levels: the mean of the levels that they are sent to
            would be 6 of 10 for robots that always succeed.
    """

    def __init__(self, cfg: CurriculumTermCfg, env: ManagerBasedRlEnv) -> None:
        self.levels = tile_terrain(env).terrain_levels.clone()
        self.passed = torch.zeros(env.num_envs, dtype=torch.bool, device=env.device)

    def __call__(
        self,
        env: ManagerBasedRlEnv,
        env_ids: Tensor,
        easier_kinds: tuple[str, ...] = (),
        easier_share: Schedule = 0.0,
        easier_levels: Schedule = LEVELS,
    ) -> dict[str, Tensor]:
        """Set levels and tiles of robots whose episodes end; returns each kind's mean level."""
        terrain, command = tile_terrain(env), goal(env)
        steps = env.episode_length_buf[env_ids]
        left = (env.max_episode_length - steps).clamp_min(0) * env.step_dt
        failed = env.termination_manager.terminated[env_ids]
        owed = command.commanded_distance[env_ids] + failed * left * command.speed[env_ids]
        distance = distance_from_start(env)[env_ids]
        before, types = self.levels[env_ids], terrain.terrain_types[env_ids]
        counts = (steps > 0) & (terrain.terrain_levels[env_ids] == before)
        up = counts & (distance > TILE / 2)
        down = counts & ~up & (distance < 0.5 * owed.clamp_max(TILE / 2))
        level = before + up.long() - down.long()
        highest = len(terrain.terrain_origins)
        tiles = terrain.cfg.terrain_generator.sub_terrains
        flat_starts = (kind for kind, tile in tiles.items() if getattr(tile, "flat_start", False))
        lowest = on_tiles(env, *flat_starts)[env_ids].long()
        retry = lowest + torch.randint_like(level, FIRST_LEVELS)
        level = torch.where((before >= lowest) & (level < lowest), retry, level).clamp_min(0)
        self.passed[env_ids] = (level >= highest) | (self.passed[env_ids] & ~down)
        level = torch.where(level >= highest, torch.randint_like(level, highest), level)
        if has_barriers(env):
            confined = on_tiles(env, *BARRIERS)[env_ids]
            level = torch.where(confined, torch.randint_like(level, highest), level)
            self.passed[env_ids] &= ~confined
        self.levels[env_ids] = level
        tile = level
        done = environment_steps(env)
        if share := value_at(easier_share, done):
            drawn = torch.rand_like(level, dtype=torch.float) < share
            drawn &= on_tiles(env, *easier_kinds)[env_ids] & (level > lowest)
            count = (level - lowest + 1).clamp_max(value_at(easier_levels, done))
            easier = lowest + (torch.rand_like(level, dtype=torch.float) * count).long()
            tile = torch.where(drawn, easier, level)
        terrain.terrain_levels[env_ids] = tile
        terrain.env_origins[env_ids] = terrain.terrain_origins[tile, types]
        reached = torch.where(self.passed, highest, self.levels).float()
        means = torch.zeros(len(tiles), device=env.device).scatter_reduce(
            0, terrain.terrain_types, reached, "mean", include_self=False
        )
        levels = dict(zip(tiles, means.unbind(), strict=True))
        return {kind: level for kind, level in levels.items() if kind not in BARRIERS}


def on_easier_tile(env: ManagerBasedRlEnv) -> Tensor:
    """1 on a tile easier than the robot's own level, [N, 1]."""
    manager = getattr(env, "curriculum_manager", None)  # mjlab makes it after the observations.
    if manager is None or "level" not in manager.active_terms:
        return torch.zeros(env.num_envs, 1, device=env.device)
    return (tile_terrain(env).terrain_levels < _levels(env).levels).float().unsqueeze(-1)


class reward_weight:
    """Let a reward's weight follow a schedule; logs it.

    Parameters: `reward`, its name; `schedule` of its weight.
    """

    def __init__(self, cfg: CurriculumTermCfg, env: ManagerBasedRlEnv) -> None:
        name, schedule = cfg.params["reward"], cfg.params["schedule"]
        weight = env.reward_manager.get_term_cfg(name).weight
        if weight != value_at(schedule, 0.0):
            raise RenetError(
                f"the weight of the reward {name} is {weight}, but its schedule begins with "
                f"{value_at(schedule, 0.0)}: change the schedule in its place, with "
                f"--env.curriculum.{name.replace('_', '-')}-weight.params.schedule"
            )

    def __call__(
        self, env: ManagerBasedRlEnv, env_ids: Tensor, reward: str, schedule: Schedule
    ) -> Tensor:
        weight = value_at(schedule, environment_steps(env))
        env.reward_manager.get_term_cfg(reward).weight = weight
        return torch.tensor(weight)


def command_stage(
    env: ManagerBasedRlEnv, env_ids: Tensor, after: float, standing_time: Schedule = 1.0
) -> Tensor:
    """Ask for standing, too, after so many environment steps; returns the stage, 0 or 1.

    Goals to stand last `standing_time` times as long as others.
    """
    command, steps = goal(env), environment_steps(env)
    if steps >= after:
        command.stage = 1
    command.standing_time = value_at(standing_time, steps)
    return torch.tensor(float(command.stage))


def curriculum_state(env: ManagerBasedRlEnv) -> dict[str, Tensor]:
    """Levels, command stage and control steps of an environment, for checkpoints."""
    state = {
        "command_stage": torch.tensor(goal(env).stage),
        "common_step_counter": torch.tensor(env.common_step_counter),
    }
    if "level" in env.curriculum_manager.active_terms:
        term, kinds = _levels(env), tile_terrain(env).terrain_types
        state |= {"levels": term.levels, "passed": term.passed, "kinds": kinds}
    return state


def load_curriculum_state(env: ManagerBasedRlEnv, state: dict[str, Tensor], steps: int) -> None:
    """Restore `curriculum_state` of a run that has taken so many environment steps.

    Other numbers of robots on the tiles resample the levels.
    """
    goal(env).stage = int(state["command_stage"])
    env.common_step_counter = int(state["common_step_counter"])
    terms = env.curriculum_manager.active_terms
    if "environment_steps" in terms:
        env.curriculum_manager.get_term_cfg("environment_steps").func.count = steps  # type: ignore[union-attr]
    if "level" not in terms or "levels" not in state:
        return
    term, terrain = _levels(env), tile_terrain(env)
    kinds = state["kinds"].to(env.device)
    robots = torch.arange(env.num_envs, device=env.device)
    if not torch.equal(kinds, terrain.terrain_types):
        for kind in kinds.unique():
            here, pool = terrain.terrain_types == kind, (kinds == kind).nonzero()[:, 0]
            picks = torch.randint(len(pool), (int(here.sum()),), device=env.device)
            robots[here] = pool[picks]
    shared = torch.isin(terrain.terrain_types, kinds)
    for name in ("levels", "passed"):
        if name in state:
            getattr(term, name)[shared] = state[name].to(env.device)[robots[shared]]
    terrain.terrain_levels[:] = term.levels
    terrain.env_origins[:] = terrain.terrain_origins[term.levels, terrain.terrain_types]


def _levels(env: ManagerBasedRlEnv) -> TerrainLevels:
    return env.curriculum_manager.get_term_cfg("level").func  # type: ignore[union-attr]
