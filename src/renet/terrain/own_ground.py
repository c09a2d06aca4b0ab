"""A user's own ground as a kind of tile: a height map, or the static geoms of an MJCF scene.

A scene is first compiled in a process of its own with limits (see `renet.trial`), because MuJoCo
may need any time and memory for a file.
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from renet.errors import RenetError
from renet.files import MEGABYTE, require_regular
from renet.terrain.height_map import ARRAY, PICTURE, interpolate, read_heights
from renet.terrain.tiles import FLAT_RELIEF, LEVELS, TILE, Tile, TileBuilder
from renet.trial import judge, run_trial

SCENE = ".xml"
"""Suffix of MJCF scenes."""
MAX_SCENE = 20 * MEGABYTE
"""Largest size of an MJCF file, bytes."""
FINEST = 0.05
"""Smallest distance between the samples of a tile, m. Finer maps cost time in every contact."""
RIM = 0.4
"""Width of the slope at a tile's border, over which a height map reaches height zero, m."""
START_PAD = 0.5
"""Half-width of the level square on which robots start, m."""
START_SLOPE = 0.4
"""Width of the slope around that square, m."""
START_AREA = 0.4
"""Half-width of the square in the middle of a scene above whose highest point robots start, m."""
HEADROOM = 0.6
"""Smallest free height above the ground on which a robot starts, m."""
ABOVE = 1e-3
"""Distance from a surface to the start of a ray upwards, m."""
BELOW = 1e-6
"""Distance from a surface to the start of the next ray downwards, m."""
TOUCHED = 1
"""Bit of a geom's contype to which the robots' geoms respond."""
SOLID = 0
"""MuJoCo's group of geoms that rays look for."""
PASSABLE = 5
"""MuJoCo's group of geoms that rays pass through."""
BASE = 0.2
"""Thickness of the ground below the lowest point of a height map, m."""


@dataclass(frozen=True, kw_only=True)
class GroundFile:
    """File of a user's own ground, with the sizes that the file does not state."""

    file: Path
    """Height map (.npy, .png) or MJCF scene (.xml)."""
    width: float = TILE
    """Width of a height map along x, m."""
    height: float = 0.3
    """Height of white above black in a .png, m."""

    def tile(self) -> Tile:
        """Build a kind of tile from the file.

        Raises:
            RenetError: The file is no ground that a tile can have.
        """
        kinds = {SCENE: OwnScene, ARRAY: OwnHeights, PICTURE: OwnHeights}
        kind = kinds.get(self.file.suffix.lower())
        if kind is None:
            raise RenetError(
                f"{self.file.name} is no ground: give a height map (.npy, .png) or an MJCF scene"
                " (.xml)"
            )
        if not (0.0 < self.width < np.inf and 0.0 < self.height < np.inf):
            raise RenetError(
                f"a height map's width and height must be positive, got {self.width:g} and"
                f" {self.height:g} m"
            )
        return kind(source=self)


@dataclass(kw_only=True)
class OwnHeights(Tile):
    """Tile of a height map, with a tenth of its relief at level 1 and all of it at level 10.

    Of a map that is larger than a tile, each level shows a random piece. The middle of a tile is
    level, so that robots can start there, and its border is at height 0 like those of other tiles.
    """

    source: GroundFile
    """File of the map."""

    def __post_init__(self) -> None:
        source = self.source
        self.heights = read_heights(source.file, source.height)
        """Heights of the samples, [rows, columns] m."""
        rows, columns = self.heights.shape
        self.cell = source.width / (columns - 1)
        """Distance between samples, m."""
        depth = self.cell * (rows - 1)
        if min(source.width, depth) < TILE - 1e-6:
            needed = TILE * max(1.0, (columns - 1) / (rows - 1))
            raise RenetError(
                f"the height map {source.file} is {source.width:g} m by {depth:g} m, smaller than a"
                f" tile of {TILE:g} m: say that it is wider, --scene-width {needed:g}"
            )
        self.relief = max(float(np.ptp(self.heights)), FLAT_RELIEF)
        """Height of the highest point above the lowest one, m."""
        if not self.high:
            self.low = self.relief / LEVELS
            self.high = self.relief

    def build(self, builder: TileBuilder, measure: float, rng: np.random.Generator) -> float:
        """Add a piece of the map; returns the height of the start, m."""
        # Draw the piece, and sample it no finer than FINEST.
        cell = max(self.cell, FINEST)
        nodes = round(TILE / cell) + 1
        positions = np.linspace(0.0, TILE, nodes) / self.cell
        spare = np.array(self.heights.shape) - 1 - TILE / self.cell
        row, column = rng.uniform(0.0, np.maximum(spare, 0.0))
        piece = interpolate(self.heights, row + positions, column + positions)

        # Most of the border keeps its height when the slope at the border is added.
        border = np.concatenate((piece[0], piece[-1], piece[:, 0], piece[:, -1]))
        piece = (piece - float(np.median(border))) * (measure / self.relief)
        piece, start = _with_start(piece)
        _add_heights(builder, piece * _rim(nodes))
        return start


@dataclass(kw_only=True)
class OwnScene(Tile):
    """Tile of an MJCF scene's colliding geoms around its origin, the same at all levels.

    Boxes and planes that are larger than the tile are cut off at its border.
    """

    source: GroundFile
    """File of the scene."""

    def __post_init__(self) -> None:
        try_own_scene(self.source.file)
        self.model = compile_scene(self.source.file)
        """Model of the scene alone."""
        self._data = mujoco.MjData(self.model)
        mujoco.mj_kinematics(self.model, self._data)
        self.begin = start_height(self.model)
        """Height of the start, m."""
        tops = [self._top(geom) for geom in self._touched]
        # Sizes of obstacles, which do not grow with the level.
        self.low = self.high = max(tops) - min(tops)
        # Build the tile once, so that geoms that it cannot have are reported at once.
        scratch = mujoco.MjSpec()
        scratch.worldbody.add_body(name="terrain")
        self.build(TileBuilder(scratch), 0.0, np.random.default_rng(0))

    @property
    def _touched(self) -> list[int]:
        """Indices of the geoms that a robot can touch."""
        return np.flatnonzero(self.model.geom_contype & TOUCHED).tolist()

    def _pose(self, geom: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the position, [3] m, and the rotation, [3, 3], of a geom in the scene."""
        return self._data.geom_xpos[geom], self._data.geom_xmat[geom].reshape(3, 3)

    def _top(self, geom: int) -> float:
        """Return the height of a geom's highest point, m."""
        model = self.model
        position, rotation = self._pose(geom)
        height = float(position[2])
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX:
            height += float((np.abs(rotation) @ model.geom_size[geom])[2])
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_HFIELD:
            height += float(model.hfield_size[model.geom_dataid[geom], 2])
        return height

    def build(self, builder: TileBuilder, measure: float, rng: np.random.Generator) -> float:
        """Add the geoms; returns the height of the start, m."""
        for geom in self._touched:
            self._add(builder, geom)
        return self.begin

    def _add(self, builder: TileBuilder, geom: int) -> None:
        """Add one geom of the scene, cut off at the tile's border.

        Raises:
            RenetError: A tile cannot have this shape, or the geom reaches beyond its border.
        """
        model = self.model
        kind = mujoco.mjtGeom(model.geom_type[geom])
        position, rotation = self._pose(geom)
        upright = np.allclose(rotation, np.eye(3), atol=1e-6)
        color = (*model.geom_rgba[geom, :3].tolist(), 1.0)
        name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_GEOM, geom) or f"number {geom}"
        if kind == mujoco.mjtGeom.mjGEOM_PLANE and upright:
            builder.square(TILE / 2, (position[2] - BASE, position[2]), color)
        elif kind == mujoco.mjtGeom.mjGEOM_BOX:
            _add_box(builder, position, rotation, model.geom_size[geom], color, name)
        elif kind == mujoco.mjtGeom.mjGEOM_HFIELD and upright:
            _add_field(builder, model, geom, position, color, name)
        else:
            shape = kind.name.removeprefix("mjGEOM_").lower()
            tilted = "" if upright else " that is turned"
            raise RenetError(
                f"cannot use the scene {self.source.file}: its geom {name} is a {shape}{tilted};"
                " training and studies know boxes, level planes and upright height fields (renet"
                " deploy --scene takes every shape)"
            )


def _with_start(heights: np.ndarray) -> tuple[np.ndarray, float]:
    """Level the middle of a tile, with a slope around it.

    Args:
        heights: Heights of the tile, [N, N] m.

    Returns:
        The new heights, and the height of the middle, m.
    """
    position = np.abs(np.linspace(-TILE / 2, TILE / 2, len(heights)))
    # In the maximum norm: from a square in the middle to the border.
    distance = np.maximum(position[:, None], position[None])
    level = float(heights[distance <= START_PAD].mean())
    weight = np.clip((distance - START_PAD) / START_SLOPE, 0.0, 1.0)
    return level + (heights - level) * weight, level


def _rim(nodes: int) -> np.ndarray:
    """Return weights [N, N] that fall to 0 at the border of a tile."""
    position = np.linspace(0.0, TILE, nodes)
    weight = np.clip(np.minimum(position, TILE - position) / RIM, 0.0, 1.0)
    return np.minimum(weight[:, None], weight[None])


def _add_heights(builder: TileBuilder, heights: np.ndarray) -> None:
    """Add a height field of the tile's size, with heights [N, N] m."""
    lowest = float(heights.min())
    relief = max(float(np.ptp(heights)), FLAT_RELIEF)
    size = (TILE / 2, TILE / 2, relief, BASE)
    builder.height_field((heights - lowest) / relief, size, (0.0, 0.0, lowest))


def _add_box(
    builder: TileBuilder,
    position: np.ndarray,
    rotation: np.ndarray,
    half: np.ndarray,
    color: tuple,
    name: str,
) -> None:
    """Add the part of a box that is inside the tile.

    Args:
        builder: Builder of the tile.
        position: Middle of the box, [3] m.
        rotation: Rotation of the box, [3, 3].
        half: Half of its sides, [3] m.
        color: Color of the box.
        name: Name of the box, for messages.

    Raises:
        RenetError: The box is turned and reaches beyond the border, so that it cannot be cut.
    """
    reach = np.abs(rotation) @ half
    low = position - reach
    high = position + reach
    if (low[:2] >= TILE / 2).any() or (high[:2] <= -TILE / 2).any():
        return
    # A box along the axes is cut off.
    if np.allclose(np.abs(rotation).max(axis=0), 1.0, atol=1e-6):
        low[:2] = np.maximum(low[:2], -TILE / 2)
        high[:2] = np.minimum(high[:2], TILE / 2)
        x, y, z = zip(low.tolist(), high.tolist(), strict=True)
        builder.box(x, y, z, color)
        return
    _demand_inside(low, high, name)
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, rotation.ravel())
    builder.turned_box(position, half, quaternion, color)


def _add_field(
    builder: TileBuilder,
    model: mujoco.MjModel,
    geom: int,
    position: np.ndarray,
    color: tuple,
    name: str,
) -> None:
    """Add a height field of a scene; raises RenetError where it reaches beyond the tile."""
    number = int(model.geom_dataid[geom])
    half_x, half_y, relief, depth = model.hfield_size[number]
    reach = np.array([half_x, half_y, 0.0])
    _demand_inside(position - reach, position + reach, name)
    rows = int(model.hfield_nrow[number])
    columns = int(model.hfield_ncol[number])
    first = int(model.hfield_adr[number])
    heights = model.hfield_data[first : first + rows * columns].reshape(rows, columns)
    builder.height_field(heights, (half_x, half_y, relief, depth), position, color)


def _demand_inside(low: np.ndarray, high: np.ndarray, name: str) -> None:
    """Raise RenetError for a geom between the corners `low` and `high` that leaves the tile."""
    if max(-low[:2].min(), high[:2].max()) > TILE / 2 + 1e-6:
        raise RenetError(
            f"geom {name} of the scene reaches beyond the {TILE:g} m square around its origin, the"
            " tile that is used: cut it off, or move it"
        )


def try_own_scene(file: Path) -> None:
    """Raise RenetError unless a scene holds ground, without loading it in this process."""
    require_regular(file, MAX_SCENE, "scene")
    run_trial("renet.terrain.own_ground", [str(file)], f"cannot use the scene {file}")


def _trial() -> str:
    """Return the error in the scene that the command line names; empty if there is none."""
    try:
        start_height(compile_scene(Path(sys.argv[1])))
    except RenetError as error:
        return str(error)
    return ""


def compile_scene(file: Path) -> mujoco.MjModel:
    """Compile a scene.

    Raises:
        RenetError: MuJoCo cannot compile the file, or a body of it can move.
    """
    try:
        model = mujoco.MjSpec.from_file(str(file)).compile()
    except ValueError as error:
        raise RenetError(f"{' '.join(str(error).split())}; give MJCF that MuJoCo loads") from error
    if model.njnt:
        body = model.body(model.jnt_bodyid[0]).name
        raise RenetError(
            f"its body {body!r} moves: give the ground alone, without robots or other bodies that"
            " have joints"
        )
    return model


def start_height(model: mujoco.MjModel) -> float:
    """Return the height of the highest surface below a robot at x = y = 0, m."""
    positions = np.linspace(-START_AREA, START_AREA, 5)
    heights = []
    for x in positions:
        for y in positions:
            heights.append(ground_height(model, x, y))
    return max(heights)


def ground_height(model: mujoco.MjModel, x: float = 0.0, y: float = 0.0) -> float:
    """Return the height, m, of the surface at (x, y) that carries a robot.

    Of several surfaces it is the one nearest to z = 0.

    Raises:
        RenetError: No surface there carries a robot and has room above it.
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    rays = _Rays(model, data, x, y)
    # From just above everything, because rays from far away miss meshes.
    z = float(np.max(data.geom_xpos[:, 2] + model.geom_rbound, initial=0.0)) + 1.0
    heights = []
    while (distance := rays.cast(z, -1)) >= 0.0:
        z -= distance
        if rays.normal_z > 0.0:
            room = rays.cast(z + ABOVE, 1)
            # A ray from within a geom leaves it through a surface that faces up.
            if room < 0.0 or (room >= HEADROOM and rays.normal_z < 0.0):
                heights.append(z)
        z -= BELOW
    if not heights:
        place = f"x = {x:g}, y = {y:g}" if x or y else "x = y = 0"
        raise RenetError(
            f"nothing carries a robot at {place}: put a geom there that collides"
            f" (contype 1), with {HEADROOM:g} m of room above it"
        )
    return min(heights, key=abs)


class _Rays:
    """Vertical rays at (x, y) that find the surfaces of static geoms that a robot can touch."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, x: float, y: float) -> None:
        """Initialize the rays; `data` holds the poses of the model's geoms."""
        static = model.body_weldid[model.geom_bodyid] == 0
        carries = static & (model.geom_contype & TOUCHED > 0)
        self._model = model.__copy__()
        self._model.geom_group[:] = np.where(carries, SOLID, PASSABLE)
        # Rays would pass through invisible geoms.
        self._model.geom_matid[:] = -1
        self._model.geom_rgba[:, 3] = 1.0
        self._data = data
        self._groups = (np.arange(mujoco.mjNGROUP) == SOLID).astype(np.uint8)
        self._position = (x, y)
        self._normal = np.zeros((3, 1))

    @property
    def normal_z(self) -> float:
        """Vertical part of the normal of the surface that the last ray met."""
        return self._normal[2, 0]

    def cast(self, z: float, direction: int) -> float:
        """Return the distance from a height to the next surface, m, or -1 if there is none.

        Args:
            z: Height at which the ray begins, m.
            direction: 1 for a ray upwards, -1 for one downwards.
        """
        eye = np.array([*self._position, z])
        ray = np.array([0.0, 0.0, direction])
        geom = np.zeros(1, np.int32)
        return mujoco.mj_ray(
            self._model, self._data, eye, ray, self._groups, 1, -1, geom, self._normal
        )


if __name__ == "__main__":
    judge(_trial)
