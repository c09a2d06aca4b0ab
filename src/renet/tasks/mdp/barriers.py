"""Walls and ledges: where a robot is told to go on, and is right to stop."""

from mjlab.envs import ManagerBasedRlEnv
from torch import Tensor

from renet.tasks.mdp.base_state import base_position, on_tiles, tile_terrain
from renet.tasks.mdp.commands import goal
from renet.terrain.tiles import BARRIERS

STOP = 0.7
"""Distance of the base from a wall or an edge at which a robot is to stop, m: its head is half as
far from it."""


def before_barrier(env: ManagerBasedRlEnv) -> Tensor:
    """Whether what a robot is told leads it against a wall or over an edge nearby, [N] bool."""
    here = on_tiles(env, *BARRIERS)
    if not has_barriers(env):
        return here
    command = goal(env)
    return here & (command.speed > 0.0) & (way_left(env, command.direction) < STOP)


def has_barriers(env: ManagerBasedRlEnv) -> bool:
    """Whether there are walls or ledges among the tiles of a task."""
    terrain = tile_terrain(env)
    if terrain is None or terrain.cfg.terrain_generator is None:
        return False
    return not set(BARRIERS).isdisjoint(terrain.cfg.terrain_generator.sub_terrains)


def way_left(env: ManagerBasedRlEnv, direction: Tensor) -> Tensor:
    """Distance to the end of the ground along unit vectors [N, 2] in the world frame, [N] m.

    It means nothing on tiles without barriers.
    """
    half = goal(env).clear[tile_terrain(env).terrain_types].unsqueeze(-1)
    position = (base_position(env) - env.scene.env_origins)[:, :2]
    # Each side that the direction leads to is met after so many metres.
    left = (half - position * direction.sign()) / direction.abs().clamp_min(1e-6)
    return left.amin(-1)
