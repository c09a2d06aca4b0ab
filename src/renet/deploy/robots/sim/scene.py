"""Scenes of a simulated robot: a plane, a training tile, or the user's height map or MJCF."""

from pathlib import Path

import mujoco
import numpy as np

from renet.deploy.robots.sim.scene_file import attach_scene, ground_height, try_scene
from renet.robots import GO1, Robot
from renet.robots.model import simulation_model
from renet.terrain.height_map import ARRAY, PICTURE
from renet.terrain.own_ground import GroundFile
from renet.terrain.tiles import LEVELS, TILE, Tile, difficulty_of, find_tile

TERRAIN = "terrain"
"""Name of the body of a tile."""
FLAT = "flat"
"""Name of the plane."""
BORDER = 1000.0
"""Half-width of the ground around a tile, m."""
GROUND = (0.62, 0.60, 0.56, 1.0)
"""Colour of the ground, RGBA."""


def build_scene(
    terrain: str = FLAT,
    level: int = 3,
    file: Path | str | None = None,
    seed: int = 0,
    robot: Robot = GO1,
    width: float = TILE,
    height: float = 0.3,
) -> tuple[mujoco.MjModel, float]:
    """Compile `scene_spec`; returns the model, and the height of the ground at x = y = 0, m."""
    spec, start = scene_spec(terrain, level, file, seed, robot, width, height)
    return spec.compile(), start


def scene_spec(
    terrain: str = FLAT,
    level: int = 3,
    file: Path | str | None = None,
    seed: int = 0,
    robot: Robot = GO1,
    width: float = TILE,
    height: float = 0.3,
) -> tuple[mujoco.MjSpec, float]:
    """Make a scene with a robot in it.

    Args:
        terrain: `FLAT`, or the name of a training tile.
        level: Level of the tile, 1 to 10.
        file: File that replaces the terrain: an MJCF scene or a height map.
        seed: Seed of the random parts of the terrain.
        robot: The robot.
        width: Width of a height map, m, see `GroundFile`.
        height: Height of white above black in a picture, m.

    Returns:
        The scene, and the height of the ground at x = y = 0, where the robot starts, m.

    Raises:
        RenetError: The terrain or level is unknown, or no robot can stand in the file's scene.
    """
    spec = simulation_model(robot)
    spec.worldbody.add_light(type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, dir=(0.3, 0.2, -1))
    start = 0.0
    if file is not None and Path(file).suffix.lower() in (ARRAY, PICTURE):
        ground = GroundFile(file=Path(file), width=width, height=height)
        start = _add_tile(spec, ground.tile(), LEVELS, seed)
    elif file is not None:
        file = Path(file)
        try_scene(file, robot)
        attach_scene(spec, file)
        start = ground_height(spec.copy().compile())
    elif terrain == FLAT:
        plane = mujoco.mjtGeom.mjGEOM_PLANE
        spec.worldbody.add_geom(type=plane, size=(BORDER, BORDER, 1), rgba=GROUND)
    else:
        start = _add_tile(spec, find_tile(terrain, level), level, seed)
    return spec, start


def _ground(body: mujoco.MjsBody, position: tuple[float, float], half: tuple[float, float]) -> None:
    """Add a slab at an x and y, m, with half-widths in m, whose top is at z = 0."""
    box = mujoco.mjtGeom.mjGEOM_BOX
    body.add_geom(type=box, size=(*half, 0.5), pos=(*position, -0.5), rgba=GROUND)


def _add_tile(spec: mujoco.MjSpec, tile: Tile, level: int, seed: int) -> float:
    """Add a training tile with its middle at the origin, and ground around it.

    Returns:
        Height of the ground at the origin, m.
    """
    spec.worldbody.add_body(name=TERRAIN)
    built = tile.function(difficulty_of(level), spec, np.random.default_rng(seed))
    middle = np.array([TILE / 2, TILE / 2, 0.0])
    for part in built.geometries:
        part.geom.pos = np.asarray(part.geom.pos) - middle
    half = (BORDER - TILE / 2) / 2
    body = spec.body(TERRAIN)
    away = TILE / 2 + half
    # Four slabs, one on each side of the tile.
    for side in (-1, 1):
        _ground(body, (side * away, 0.0), (half, BORDER))
        _ground(body, (0.0, side * away), (TILE / 2, half))
    return float(built.origin[2])
