"""Somebody's own ground as a kind of tile: a height map, or the static geoms of an MJCF scene.

A scene is first tried in a process with limits, for MuJoCo may compile one without end.
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from renet.errors import RenetError
from renet.files import MEGABYTE, require_regular
from renet.terrain.height_map import ARRAY, PICTURE, interpolate, read_heights
from renet.terrain.tiles import (
    FLAT,
    LEVELS,
    STONE,
    TILE,
    Tile,
    TileBuilder,
    TileGeom,
)
from renet.trial import judge, run_trial

SCENE = ".xml"
KIND = "own"
"""Name of the kind of tile among others."""
MAX_SCENE = 20 * MEGABYTE
"""Bytes of an MJCF file."""
FINEST = 0.05
"""Smallest distance between the samples of a tile, m: finer maps cost time in every contact."""
RIM = 0.4
"""Metres over which a height map sinks or rises to zero at the tile's border."""
START_PAD, START_SLOPE = 0.5, 0.4
"""Half-width of the level square on which robots start, and of the ramp around it, m."""
START_AREA = 0.4
"""Half-width of the square around the middle of a scene whose highest point robots start above."""
HEADROOM = 0.6
"""Metres that must be free above the ground on which a robot starts."""
ABOVE, BELOW = 1e-3, 1e-6
"""Metres from a surface to the start of the next ray up and down."""
TOUCHED = 1
"""The bit of a geom's contype that robots' geoms answer to."""
CARRIED, IGNORED = 0, 5
"""MuJoCo groups of geoms for rays that look for ground."""
CORNER = np.array([TILE / 2, TILE / 2, 0.0])
"""From a tile's corner to its middle, m."""
BASE = 0.2
"""Thickness of what lies below a height map, m."""


@dataclass(frozen=True, kw_only=True)
class GroundFile:
    """A file of ground, and what it does not say of itself."""

    file: Path
    """Height map (.npy, .png) or MJCF scene (.xml)."""
    width: float = TILE
    """Metres that a height map is wide, along x."""
    height: float = 0.3
    """Metres of white above black in a .png."""

    def tile(self) -> Tile:
        """A tile of this ground; raises RenetError for a file of which none can be made."""
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
    """A height map: a tenth of its relief at level 1, all of it at level 10.

    Of a map that is wider than a tile, each level takes another piece, drawn at random. The middle
    is level for robots to start on, and the border meets other tiles at height 0.
    """

    source: GroundFile

    def __post_init__(self) -> None:
        source = self.source
        self.heights = read_heights(source.file, source.height)
        """[rows, columns] m."""
        rows, columns = self.heights.shape
        self.cell = source.width / (columns - 1)
        """Metres between samples."""
        depth = self.cell * (rows - 1)
        if min(source.width, depth) < TILE - 1e-6:
            needed = TILE * max(1.0, (columns - 1) / (rows - 1))
            raise RenetError(
                f"the height map {source.file} is {source.width:g} m by {depth:g} m, smaller than a"
                f" tile of {TILE:g} m: say that it is wider, --scene-width {needed:g}"
            )
        self.relief = max(float(np.ptp(self.heights)), FLAT)
        """Height of its highest point above its lowest, m."""
        if not self.high:
            self.low, self.high = self.relief / LEVELS, self.relief

    def build(self, builder: TileBuilder, measure: float, rng: np.random.Generator) -> float:
        """Add a piece of the map; returns the height of the start, m."""
        cell = max(self.cell, FINEST)
        nodes = round(TILE / cell) + 1
        place = np.linspace(0.0, TILE, nodes) / self.cell
        spare = np.array(self.heights.shape) - 1 - TILE / self.cell
        row, column = rng.uniform(0.0, np.maximum(spare, 0.0))
        piece = interpolate(self.heights, row + place, column + place)
        level = float(np.median(np.concatenate((piece[0], piece[-1], piece[:, 0], piece[:, -1]))))
        piece = (piece - level) * (measure / self.relief)
        piece, start = _with_start(piece)
        _add_heights(builder, piece * _rim(nodes))
        return start


@dataclass(kw_only=True)
class OwnScene(Tile):
    """What collides of an MJCF scene within the tile around its origin, the same at every level.

    Boxes and planes that reach beyond are cut off at the tile's border.
    """

    source: GroundFile

    def __post_init__(self) -> None:
        try_scene(self.source.file)
        self.model = compile_scene(self.source.file)
        """The scene by itself."""
        self._data = mujoco.MjData(self.model)
        mujoco.mj_kinematics(self.model, self._data)
        self.begin = start_height(self.model)
        """Height of the start, m."""
        tops = [self._top(geom) for geom in self._touched]
        # The same at every level: what grows with it on other tiles.
        self.low = self.high = max(tops) - min(tops)
        scratch = mujoco.MjSpec()
        scratch.worldbody.add_body(name="terrain")
        self.build(TileBuilder(scratch), 0.0, np.random.default_rng(0))  # What cannot be is told.

    @property
    def _touched(self) -> list[int]:
        """Numbers of the geoms that a robot can touch."""
        return np.flatnonzero(self.model.geom_contype & TOUCHED).tolist()

    def _pose(self, geom: int) -> tuple[np.ndarray, np.ndarray]:
        """Position [3] m and rotation [3, 3] of a geom in the scene."""
        return self._data.geom_xpos[geom], self._data.geom_xmat[geom].reshape(3, 3)

    def _top(self, geom: int) -> float:
        """Height of a geom's highest point, m."""
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
        """Add one geom of the scene, cut off at the tile's border; raises RenetError."""
        model, kind = self.model, mujoco.mjtGeom(self.model.geom_type[geom])
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
    """Heights [N, N] with a level middle and a ramp around it, and the height of the middle, m."""
    place = np.abs(np.linspace(-TILE / 2, TILE / 2, len(heights)))
    distance = np.maximum(place[:, None], place[None])
    level = float(heights[distance <= START_PAD].mean())
    weight = np.clip((distance - START_PAD) / START_SLOPE, 0.0, 1.0)
    return level + (heights - level) * weight, level


def _rim(nodes: int) -> np.ndarray:
    """Weights [N, N] that fall to 0 at the border of a tile."""
    place = np.linspace(0.0, TILE, nodes)
    weight = np.clip(np.minimum(place, TILE - place) / RIM, 0.0, 1.0)
    return np.minimum(weight[:, None], weight[None])


def _add_heights(builder: TileBuilder, heights: np.ndarray) -> None:
    """Add a height field of the tile's size from heights [N, N], m."""
    lowest = float(heights.min())
    relief = max(float(np.ptp(heights)), FLAT)
    field = builder.spec.add_hfield(
        name=f"{KIND}_{len(builder.spec.hfields)}",
        size=(TILE / 2, TILE / 2, relief, BASE),
        nrow=len(heights),
        ncol=len(heights),
        userdata=((heights - lowest) / relief).flatten(),
    )
    geom = builder.body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_HFIELD,
        hfieldname=field.name,
        pos=(TILE / 2, TILE / 2, lowest),
        rgba=STONE,
    )
    builder.geometries.append(TileGeom(geom, STONE, field))


def _add_box(
    builder: TileBuilder,
    position: np.ndarray,
    rotation: np.ndarray,
    half: np.ndarray,
    color: tuple,
    name: str,
) -> None:
    """Add what a tile holds of a box; raises RenetError for a turned one that reaches beyond."""
    reach = np.abs(rotation) @ half
    low, high = position - reach, position + reach
    if (low[:2] >= TILE / 2).any() or (high[:2] <= -TILE / 2).any():
        return
    if np.allclose(np.abs(rotation).max(axis=0), 1.0, atol=1e-6):  # Along the axes.
        low[:2] = np.maximum(low[:2], -TILE / 2)
        high[:2] = np.minimum(high[:2], TILE / 2)
        x, y, z = zip(low.tolist(), high.tolist(), strict=True)
        builder.box(x, y, z, color)
        return
    _demand_inside(low, high, name)
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, rotation.ravel())
    geom = builder.body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=half,
        pos=position + CORNER,
        quat=quaternion,
        rgba=color,
    )
    builder.geometries.append(TileGeom(geom, color))


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
    rows, columns = int(model.hfield_nrow[number]), int(model.hfield_ncol[number])
    first = int(model.hfield_adr[number])
    field = builder.spec.add_hfield(
        name=f"{KIND}_{len(builder.spec.hfields)}",
        size=(half_x, half_y, relief, depth),
        nrow=rows,
        ncol=columns,
        userdata=model.hfield_data[first : first + rows * columns],
    )
    added = builder.body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_HFIELD,
        hfieldname=field.name,
        pos=position + CORNER,
        rgba=color,
    )
    builder.geometries.append(TileGeom(added, color, field))


def _demand_inside(low: np.ndarray, high: np.ndarray, name: str) -> None:
    if max(-low[:2].min(), high[:2].max()) > TILE / 2 + 1e-6:
        raise RenetError(
            f"geom {name} of the scene reaches beyond the {TILE:g} m square around its origin, the"
            " tile that is used: cut it off, or move it"
        )


def try_scene(file: Path) -> None:
    """Raise RenetError unless a scene holds ground, without loading it in this process."""
    require_regular(file, MAX_SCENE, "scene")
    run_trial("renet.terrain.own_ground", [str(file)], f"cannot use the scene {file}")


def _trial() -> str:
    """What is wrong with the scene that the command line names."""
    try:
        start_height(compile_scene(Path(sys.argv[1])))
    except RenetError as error:
        return str(error)
    return ""


def compile_scene(file: Path) -> mujoco.MjModel:
    """A scene's model; raises RenetError where MuJoCo cannot compile it, or something moves."""
    try:
        model = mujoco.MjSpec.from_file(str(file)).compile()
    except ValueError as error:
        raise RenetError(str(error).splitlines()[0]) from error
    if model.njnt:
        body = model.body(model.jnt_bodyid[0]).name
        raise RenetError(
            f"its body {body!r} moves: give the ground alone, without robots or other bodies that"
            " have joints"
        )
    return model


def start_height(model: mujoco.MjModel) -> float:
    """Height in m of the highest surface that a robot around x = y = 0 stands on."""
    places = np.linspace(-START_AREA, START_AREA, 5)
    return max(ground_height(model, x, y) for x in places for y in places)


def ground_height(model: mujoco.MjModel, x: float = 0.0, y: float = 0.0) -> float:
    """Height in m of the surface at a place that carries a robot and is nearest to z = 0.

    Raises:
        RenetError: nothing there carries a robot and has room above it.
    """
    data, probe = mujoco.MjData(model), model.__copy__()
    mujoco.mj_kinematics(model, data)
    static = model.body_weldid[model.geom_bodyid] == 0
    carries = static & (model.geom_contype & TOUCHED > 0)
    probe.geom_group[:] = np.where(carries, CARRIED, IGNORED)
    probe.geom_matid[:], probe.geom_rgba[:, 3] = -1, 1.0  # Rays pass through invisible geoms.
    groups, normal = np.arange(mujoco.mjNGROUP) == CARRIED, np.zeros((3, 1))

    def look(z: float, way: int) -> float:
        """Distance to the next surface up or down from a height, whose normal is kept."""
        eye, ray, geom = np.array([x, y, z]), np.array([0.0, 0.0, way]), np.zeros(1, np.int32)
        return mujoco.mj_ray(probe, data, eye, ray, groups.astype(np.uint8), 1, -1, geom, normal)

    # From just above everything: rays from far away miss meshes.
    z = float(np.max(data.geom_xpos[:, 2] + model.geom_rbound, initial=0.0)) + 1.0
    heights = []
    while (distance := look(z, -1)) >= 0.0:
        z -= distance
        if normal[2, 0] > 0.0:
            room = look(z + ABOVE, 1)
            # From within a geom, a ray upwards leaves through a surface that looks up.
            if room < 0.0 or (room >= HEADROOM and normal[2, 0] < 0.0):
                heights.append(z)
        z -= BELOW
    if not heights:
        place = f"x = {x:g}, y = {y:g}" if x or y else "x = y = 0"
        raise RenetError(
            f"nothing carries a robot at {place}: put a geom there that collides"
            f" (contype 1), with {HEADROOM:g} m of room above it"
        )
    return min(heights, key=abs)


if __name__ == "__main__":
    judge(_trial)
