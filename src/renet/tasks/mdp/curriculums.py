"""Curricula: levels of the terrain (Rudin et al. 2022), stages of commands, weights of rewards.

All that changes with time follows the number of environment steps of all robots and processes,
which the term `EnvironmentSteps` counts.
"""

import os

import torch
from mjlab.envs import ManagerBasedRlEnv
from mjlab.managers.curriculum_manager import CurriculumTermCfg
from torch import Tensor

from renet.errors import RenetError
from renet.tasks.mdp.barriers import has_barriers
from renet.tasks.mdp.base_state import distance_from_start, on_tiles, tile_terrain
from renet.tasks.mdp.commands import DriveCommand, goal
from renet.tasks.schedule import Schedule, value_at
from renet.terrain.tiles import BARRIERS, LEVELS, TILE

FIRST_LEVELS = 2
"""Number of lowest levels from which a robot draws its next one after it failed at the lowest. With
1, VP would never learn to see gaps: the narrowest, of 10 cm, is hardly visible through the camera's
noise from 30 cm above."""


class EnvironmentSteps:
    """Environment steps of all robots and processes since training began."""

    def __init__(self, cfg: CurriculumTermCfg, env: ManagerBasedRlEnv) -> None:
        self._env = env
        self._robots = env.num_envs * int(os.getenv("WORLD_SIZE", "1"))
        self._offset = 0
        """Correction for steps that a resumed run took with another number of robots."""

    def __call__(self, env: ManagerBasedRlEnv, env_ids: Tensor) -> Tensor:
        return torch.tensor(float(self.count))

    @property
    def count(self) -> int:
        """Number of environment steps taken."""
        return self._offset + self._env.common_step_counter * self._robots

    @count.setter
    def count(self, steps: int) -> None:
        self._offset += steps - self.count


def environment_steps(env: ManagerBasedRlEnv) -> int:
    """Return the number of environment steps taken by all robots and processes, in all runs."""
    return env.curriculum_manager.get_term_cfg("environment_steps").func.count  # type: ignore[union-attr]


class TerrainLevels:
    """Levels of robots on the terrain, which rise and fall with success (Rudin et al. 2022).

    At the end of an episode a robot's level

    - rises if the robot walked half a tile away from its start;
    - falls if it walked less than half of the commanded distance, of which at most half a tile
      counts. A robot that fell is measured by the distance of the whole episode, so that an early
      fall is no success. A robot whose episode was cut short, as the first ones of a run are, is
      measured by the distance until then;
    - stays if the robot did not walk, as after a checkpoint is loaded, or was on an easier tile;
    - is drawn from all levels if it passes the last one, and always between walls and on ledges,
      which no robot can leave.

    A flat first level is for robots that cannot walk yet. Failures do not lead back to it: episodes
    last longest there, and most steps would be spent on flat ground.

    Parameters:
        easier_kinds: Kinds of tile on which some episodes use an easier tile, without a change of
            the robot's level. Otherwise robots forget how to cross narrow gaps.
        easier_share: Share of these episodes, a schedule.
        easier_levels: Number of lowest levels from which these tiles are drawn uniformly, up to the
            robot's level, a schedule.

    Attributes:
        levels: Level of each robot, [N]. `terrain.terrain_levels` is that of its tile.
        passed: Robots that passed the last level and have not failed since, [N] bool. They are
            logged with the number of levels: the mean of the levels that they draw would be 6 of 10
            for robots that always succeed.
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
        """Set levels and tiles of the robots `env_ids`, whose episodes end.

        Returns:
            Mean level of the robots on each kind of tile, for the log.
        """
        terrain = tile_terrain(env)
        lowest = self._lowest_level(env, env_ids)
        level = self._next_level(env, env_ids, lowest)
        self.levels[env_ids] = level

        # Some episodes use an easier tile than that of the robot's level.
        tile_level = level
        steps = environment_steps(env)
        share = value_at(easier_share, steps)
        if share:
            is_easier = torch.rand_like(level, dtype=torch.float) < share
            is_easier &= on_tiles(env, *easier_kinds)[env_ids] & (level > lowest)
            count = (level - lowest + 1).clamp_max(value_at(easier_levels, steps))
            easier = lowest + (torch.rand_like(level, dtype=torch.float) * count).long()
            tile_level = torch.where(is_easier, easier, level)

        # Move the robots to their tiles.
        kind = terrain.terrain_types[env_ids]
        terrain.terrain_levels[env_ids] = tile_level
        terrain.env_origins[env_ids] = terrain.terrain_origins[tile_level, kind]
        return self._mean_levels(env)

    def _lowest_level(self, env: ManagerBasedRlEnv, env_ids: Tensor) -> Tensor:
        """Return the lowest level after a failure, [E]: 1 above a flat first level, else 0."""
        tiles = tile_terrain(env).cfg.terrain_generator.sub_terrains
        kinds = [kind for kind, tile in tiles.items() if getattr(tile, "flat_start", False)]
        return on_tiles(env, *kinds)[env_ids].long()

    def _next_level(self, env: ManagerBasedRlEnv, env_ids: Tensor, lowest: Tensor) -> Tensor:
        """Compute the next level of robots whose episodes end, [E], and update `passed`."""
        terrain = tile_terrain(env)
        command = goal(env)
        old_level = self.levels[env_ids]
        count = len(terrain.terrain_origins)

        # The distance to walk: until the end of the episode for a robot that fell.
        steps = env.episode_length_buf[env_ids]
        remaining_time = (env.max_episode_length - steps).clamp_min(0) * env.step_dt
        fell = env.termination_manager.terminated[env_ids]
        target = command.commanded_distance[env_ids]
        target = target + fell * remaining_time * command.speed[env_ids]

        # Up or down by the distance walked, unless the robot did not walk or was on an easier tile.
        distance = distance_from_start(env)[env_ids]
        counts = (steps > 0) & (terrain.terrain_levels[env_ids] == old_level)
        up = counts & (distance > TILE / 2)
        down = counts & ~up & (distance < 0.5 * target.clamp_max(TILE / 2))
        level = old_level + up.long() - down.long()

        # A robot that fails at the lowest level tries one of the lowest levels.
        retry = lowest + torch.randint_like(level, FIRST_LEVELS)
        fails_at_lowest = (old_level >= lowest) & (level < lowest)
        level = torch.where(fails_at_lowest, retry, level).clamp_min(0)

        # A robot that passes the last level goes to any level.
        self.passed[env_ids] = (level >= count) | (self.passed[env_ids] & ~down)
        level = torch.where(level >= count, torch.randint_like(level, count), level)

        # So does a robot that cannot leave its tile.
        if has_barriers(env):
            is_confined = on_tiles(env, *BARRIERS)[env_ids]
            level = torch.where(is_confined, torch.randint_like(level, count), level)
            self.passed[env_ids] &= ~is_confined
        return level

    def _mean_levels(self, env: ManagerBasedRlEnv) -> dict[str, Tensor]:
        """Return the mean level of the robots on each kind of tile that robots can leave."""
        terrain = tile_terrain(env)
        tiles = terrain.cfg.terrain_generator.sub_terrains
        levels = torch.where(self.passed, len(terrain.terrain_origins), self.levels).float()
        means = torch.zeros(len(tiles), device=env.device).scatter_reduce(
            0, terrain.terrain_types, levels, "mean", include_self=False
        )
        by_kind = dict(zip(tiles, means.unbind(), strict=True))
        return {kind: level for kind, level in by_kind.items() if kind not in BARRIERS}


def tile_shares(
    env: ManagerBasedRlEnv, env_ids: Tensor, shares: dict[str, Schedule]
) -> dict[str, Tensor]:
    """Move robots whose episodes end from kinds of tile with too many robots to kinds with too few.

    A robot that is moved takes the level of a random robot on its new kind. This term must come
    after `TerrainLevels`, which knows the levels. On a GPU nothing here waits for the device.

    Args:
        env: The environment.
        env_ids: Robots whose episodes end, [E].
        shares: Proportion of the robots on kinds of tile, a schedule by name. Other kinds keep the
            proportion of their configuration.

    Returns:
        Share of all robots on each of these kinds, for the log.
    """
    terrain = tile_terrain(env)
    tiles = terrain.cfg.terrain_generator.sub_terrains
    kinds = terrain.terrain_types
    levels = _levels(env)
    steps = environment_steps(env)

    # Whole robots that each kind has too many or too few.
    proportions = []
    for kind, tile in tiles.items():
        share = value_at(shares[kind], steps) if kind in shares else tile.proportion
        # A tensor of a list would be copied from the host.
        proportions.append(torch.full((), share, device=env.device))
    wanted = torch.stack(proportions)
    wanted = wanted / wanted.sum() * env.num_envs
    every_kind = torch.arange(len(tiles), device=env.device)
    is_there = kinds == every_kind.unsqueeze(-1)
    count = is_there.sum(-1)
    surplus = (count - wanted).floor()
    lack = (wanted - count).floor().clamp_min(0.0)

    # Of each kind the first robots whose episodes end leave, and fill one kind after the other.
    old = kinds[env_ids]
    rank = (old.unsqueeze(-1) == every_kind).cumsum(0).gather(1, old.unsqueeze(-1)).squeeze(-1)
    leaves = rank <= surplus[old]
    number = leaves.cumsum(0).to(lack.dtype)
    new = torch.searchsorted(lack.cumsum(0), number)
    moves = leaves & (new < len(tiles))
    new = torch.where(moves, new.clamp_max(len(tiles) - 1), old)

    # They take the level of a random robot there, the same for all that move at once.
    chance = torch.rand(env.num_envs, device=env.device)
    host = torch.where(is_there, chance, -1.0).argmax(-1)[new]
    level = torch.where(moves, levels.levels[host], levels.levels[env_ids])
    levels.levels[env_ids] = level
    levels.passed[env_ids] = torch.where(moves, levels.passed[host], levels.passed[env_ids])
    tile_level = torch.where(moves, level, terrain.terrain_levels[env_ids])
    kinds[env_ids] = new
    terrain.terrain_levels[env_ids] = tile_level
    terrain.env_origins[env_ids] = terrain.terrain_origins[tile_level, new]

    reached = (kinds == every_kind.unsqueeze(-1)).sum(-1) / env.num_envs
    return {kind: share for kind, share in zip(tiles, reached, strict=True) if kind in shares}


def on_easier_tile(env: ManagerBasedRlEnv) -> Tensor:
    """1 on a tile below the robot's level, [N, 1]."""
    # mjlab computes observations once before it creates this manager.
    manager = getattr(env, "curriculum_manager", None)
    if manager is None or "level" not in manager.active_terms:
        return torch.zeros(env.num_envs, 1, device=env.device)
    is_easier = tile_terrain(env).terrain_levels < _levels(env).levels
    return is_easier.float().unsqueeze(-1)


class reward_weight:
    """Weight of a reward that follows a schedule; returns it for the log.

    Parameters:
        reward: Name of the reward.
        schedule: Schedule of its weight.
    """

    def __init__(self, cfg: CurriculumTermCfg, env: ManagerBasedRlEnv) -> None:
        name = cfg.params["reward"]
        schedule = cfg.params["schedule"]
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
    """Set the stage of commands; returns it for the log.

    At stage 0 all commands are to walk; at stage 1 some are to stand.

    Args:
        env: The environment.
        env_ids: Robots whose episodes end; the stage is that of all robots.
        after: Number of environment steps after which stage 1 begins.
        standing_time: Duration of commands to stand, as a multiple of that of others; a schedule.
    """
    command = goal(env)
    steps = environment_steps(env)
    if steps >= after:
        command.stage = 1
    command.standing_time = value_at(standing_time, steps)
    return torch.tensor(float(command.stage))


def kick_share(env: ManagerBasedRlEnv, env_ids: Tensor, schedule: Schedule) -> Tensor:
    """Set the share of new velocities that robots are given at once; returns it for the log.

    Args:
        env: The environment.
        env_ids: Robots whose episodes end; the share is that of all robots.
        schedule: The share, from 0 to 1.
    """
    command = goal(env)
    assert isinstance(command, DriveCommand)
    command.kick_share = value_at(schedule, environment_steps(env))
    return torch.tensor(command.kick_share)


def curriculum_state(env: ManagerBasedRlEnv) -> dict[str, Tensor]:
    """Collect levels, command stage and control steps of an environment, for checkpoints."""
    state = {
        "command_stage": torch.tensor(goal(env).stage),
        "common_step_counter": torch.tensor(env.common_step_counter),
    }
    if "level" in env.curriculum_manager.active_terms:
        term = _levels(env)
        state["levels"] = term.levels
        state["passed"] = term.passed
        state["kinds"] = tile_terrain(env).terrain_types
    return state


def load_curriculum_state(env: ManagerBasedRlEnv, state: dict[str, Tensor], steps: int) -> None:
    """Restore the state that `curriculum_state` collected.

    If the numbers of robots on the kinds of tile are not those of the state, each robot takes the
    level of a random robot of the state on the same kind of tile. The highest level there is takes
    the place of levels above it.

    Args:
        env: The environment.
        state: State of another environment.
        steps: Number of environment steps that the run has taken.
    """
    goal(env).stage = int(state["command_stage"])
    env.common_step_counter = int(state["common_step_counter"])
    terms = env.curriculum_manager.active_terms
    if "environment_steps" in terms:
        env.curriculum_manager.get_term_cfg("environment_steps").func.count = steps  # type: ignore[union-attr]
    if "level" not in terms or "levels" not in state:
        return
    term = _levels(env)
    terrain = tile_terrain(env)
    kinds = state["kinds"].to(env.device)

    # Robots that went to other kinds of tile stay there, unless there are fewer kinds now.
    num_levels, num_kinds = terrain.terrain_origins.shape[:2]
    has_kinds = bool((kinds < num_kinds).all())
    if "tile_shares" in terms and len(kinds) == env.num_envs and has_kinds:
        terrain.terrain_types[:] = kinds

    # For each robot, a robot of the state on the same kind of tile.
    source = torch.arange(env.num_envs, device=env.device)
    if not torch.equal(kinds, terrain.terrain_types):
        for kind in kinds.unique():
            mask = terrain.terrain_types == kind
            candidates = (kinds == kind).nonzero()[:, 0]
            choice = torch.randint(len(candidates), (int(mask.sum()),), device=env.device)
            source[mask] = candidates[choice]

    # Kinds of tile that the state lacks keep their levels.
    known = torch.isin(terrain.terrain_types, kinds)
    for name in ("levels", "passed"):
        if name in state:
            getattr(term, name)[known] = state[name].to(env.device)[source[known]]
    # There may be fewer levels now, too.
    term.levels.clamp_(max=num_levels - 1)
    terrain.terrain_levels[:] = term.levels
    terrain.env_origins[:] = terrain.terrain_origins[term.levels, terrain.terrain_types]


def _levels(env: ManagerBasedRlEnv) -> TerrainLevels:
    """Return the term of the levels."""
    return env.curriculum_manager.get_term_cfg("level").func  # type: ignore[union-attr]
