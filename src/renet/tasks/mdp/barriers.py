"""Walls and ledges, in front of which a robot must stop against its command."""

from mjlab.envs import ManagerBasedRlEnv
from torch import Tensor

from renet.tasks.mdp.base_state import base_position, on_tiles, tile_terrain
from renet.tasks.mdp.commands import goal
from renet.terrain.tiles import BARRIERS

STOPPING_DISTANCE = 0.7
"""Distance of the base from a wall or an edge at which a robot must stop, m. The head is then half
as far away."""


def before_barrier(env: ManagerBasedRlEnv) -> Tensor:
    """Return a mask of robots whose command leads against a near wall or over an edge, [N] bool."""
    on_barriers = on_tiles(env, *BARRIERS)
    if not has_barriers(env):
        return on_barriers
    command = goal(env)
    is_near = free_distance(env, command.direction) < STOPPING_DISTANCE
    return on_barriers & (command.speed > 0.0) & is_near


def must_stand(env: ManagerBasedRlEnv) -> Tensor:
    """Return a mask of robots that are told to stand, or that a barrier stops, [N] bool."""
    return goal(env).stands | before_barrier(env)


def has_barriers(env: ManagerBasedRlEnv) -> bool:
    """Return True if the tiles of a task have walls or ledges."""
    terrain = tile_terrain(env)
    if terrain is None or terrain.cfg.terrain_generator is None:
        return False
    return not set(BARRIERS).isdisjoint(terrain.cfg.terrain_generator.sub_terrains)


def free_distance(env: ManagerBasedRlEnv, direction: Tensor) -> Tensor:
    """Compute the distance from the base to the end of the free ground.

    The result has no meaning on tiles without barriers.

    Args:
        env: The environment.
        direction: Unit vectors in the world frame, [N, 2].

    Returns:
        Distances along the directions, [N] m.
    """
    half_width = goal(env).clear[tile_terrain(env).terrain_types].unsqueeze(-1)
    position = (base_position(env) - env.scene.env_origins)[:, :2]
    # Distance to the sides of the square along x and along y; the nearer one ends the ground.
    distance = (half_width - position * direction.sign()) / direction.abs().clamp_min(1e-6)
    return distance.amin(-1)
