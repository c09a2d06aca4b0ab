"""Scenes for a simulated robot: a plane, a training tile, or anyone's height map or MJCF."""

from pathlib import Path

import mujoco
import numpy as np

from renet.deploy.robots.sim.scene_file import attach_scene, ground_height, try_scene
from renet.robots import GO1, Robot
from renet.robots.model import simulation_model
from renet.terrain.height_map import ARRAY, PICTURE
from renet.terrain.own_ground import GroundFile
from renet.terrain.tiles import TILE, Tile, find_tile

TERRAIN = "terrain"
"""Body of a tile."""
FLAT = "flat"
BORDER = 1000.0
"""Half-width of the ground around a tile, m."""
GROUND = (0.62, 0.60, 0.56, 1.0)


def build_scene(
    terrain: str = FLAT,
    level: int = 3,
    file: Path | str | None = None,
    seed: int = 0,
    robot: Robot = GO1,
    width: float = TILE,
    height: float = 0.3,
) -> tuple[mujoco.MjModel, float]:
    """The compiled `scene_spec`, and the height in m of the ground at x = y = 0."""
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
    """A scene with a robot in it, and the height in m of the ground it starts on, at x = y = 0.

    The terrain is flat, or a kind of training tile of a level, 1 to 10, with random parts by
    `seed`; a `file` replaces it, an MJCF scene, or a height map (see `GroundFile` for its `width`
    and `height`, m).

    Raises:
        RenetError: unknown terrain or level, or a scene file in which no robot can stand.
    """
    spec = simulation_model(robot)
    spec.worldbody.add_light(type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, dir=(0.3, 0.2, -1))
    start = 0.0
    if file is not None and Path(file).suffix.lower() in (ARRAY, PICTURE):
        ground = GroundFile(file=Path(file), width=width, height=height)
        start = _add_tile(spec, ground.tile(), 1.0, seed)
    elif file is not None:
        file = Path(file)
        try_scene(file, robot)
        attach_scene(spec, file)
        start = ground_height(spec.copy().compile())
    elif terrain == FLAT:
        plane = mujoco.mjtGeom.mjGEOM_PLANE
        spec.worldbody.add_geom(type=plane, size=(BORDER, BORDER, 1), rgba=GROUND)
    else:
        start = _add_tile(spec, *find_tile(terrain, level), seed)
    return spec, start


def _ground(body: mujoco.MjsBody, position: tuple[float, float], half: tuple[float, float]) -> None:
    """A slab whose top is at z = 0."""
    box = mujoco.mjtGeom.mjGEOM_BOX
    body.add_geom(type=box, size=(*half, 0.5), pos=(*position, -0.5), rgba=GROUND)


def _add_tile(spec: mujoco.MjSpec, tile: Tile, difficulty: float, seed: int) -> float:
    """A training tile with its middle at the origin, and ground around it."""
    spec.worldbody.add_body(name=TERRAIN)
    built = tile.function(difficulty, spec, np.random.default_rng(seed))
    middle = np.array([TILE / 2, TILE / 2, 0.0])
    for part in built.geometries:
        part.geom.pos = np.asarray(part.geom.pos) - middle
    half = (BORDER - TILE / 2) / 2
    body, away = spec.body(TERRAIN), TILE / 2 + half
    for side in (-1, 1):
        _ground(body, (side * away, 0.0), (half, BORDER))
        _ground(body, (0.0, side * away), (TILE / 2, half))
    return float(built.origin[2])
