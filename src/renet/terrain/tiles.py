"""Parkour tiles of 8 x 8 m, the same in all four directions, so that all goal yaws are as hard.

The robot starts in the middle and must leave the tile. Borders of tiles are at z = 0, and tiles
consist of few boxes. "Simple" tiles can be walked blind; "difficult" ones (gap, platform) need
vision (RENet, Method A). Training uses a `Tile` as one of mjlab's sub-terrains; `renet deploy`
builds it in plain MuJoCo.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from renet.errors import RenetError, unknown_name

DIFFICULT = ("gap", "platform")
"""Kinds of tile that need vision; all others are simple."""
BARRIERS = ("wall", "ledge")
"""Kinds of tile that no robot can leave: robots must stop in front of the barrier."""
TILE = 8.0
"""Side of a tile, m."""
FLAT_RELIEF = 1e-3
"""Height of edges on a flat first level, m; geoms must have a size."""
LEVELS = 10
"""Number of levels, which are the rows of the curriculum (paper)."""
OBSTACLE_GROUP = 1
"""MuJoCo's group of the geoms on the ground of a course, which a fault can turn to glass."""

Range = tuple[float, float]
Color = tuple[float, float, float, float]
STEEL = (0.42, 0.48, 0.55, 1.0)
STONE = (0.62, 0.60, 0.56, 1.0)
ACCENT = (0.80, 0.55, 0.30, 1.0)
PIT = (0.16, 0.18, 0.22, 1.0)


@dataclass(frozen=True)
class TileGeom:
    """Geom of a tile, with the fields that mjlab's generator reads."""

    geom: mujoco.MjsGeom
    color: Color
    hfield: mujoco.MjsHField | None = None


@dataclass(frozen=True)
class BuiltTile:
    """Tile in a scene, with the fields that mjlab's generator reads."""

    origin: np.ndarray
    """Start of a robot relative to the tile's corner, [3] m."""
    geometries: list[TileGeom]
    flat_patches: None = None


class TileBuilder:
    """Adds geoms to a tile; coordinates are relative to a point of it, by default its middle, m.

    A tile is one body, so that engines can skip those far away.
    """

    def __init__(self, spec: mujoco.MjSpec, origin: Range = (TILE / 2, TILE / 2)) -> None:
        """Initialize an empty tile.

        Args:
            spec: Scene of the tile.
            origin: Position of the point with coordinates zero, from the tile's corner, [2] m.
        """
        self.spec = spec
        self.origin = origin
        self.body = spec.body("terrain").add_body(name=f"tile_{len(spec.bodies)}")
        self.geometries: list[TileGeom] = []

    def box(self, x: Range, y: Range, z: Range, color: Color = STONE) -> mujoco.MjsGeom:
        """Add an axis-aligned box, given its range in each direction."""
        low, high = np.array([x, y, z]).T
        return self.turned_box((low + high) / 2, (high - low) / 2, (1.0, 0.0, 0.0, 0.0), color)

    def turned_box(
        self,
        middle: ArrayLike,
        half: ArrayLike,
        quaternion: ArrayLike,
        color: Color = STONE,
    ) -> mujoco.MjsGeom:
        """Add a box in any orientation.

        Args:
            middle: Middle of the box, [3] m.
            half: Half of its sides, [3] m.
            quaternion: Rotation of the box, (w, x, y, z).
            color: Color of the box.
        """
        geom = self.body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=half,
            pos=np.add(middle, (*self.origin, 0.0)),
            quat=quaternion,
            rgba=color,
        )
        self.geometries.append(TileGeom(geom, color))
        return geom

    def height_field(
        self,
        heights: np.ndarray,
        size: ArrayLike,
        middle: ArrayLike = (0.0, 0.0, 0.0),
        color: Color = STONE,
    ) -> None:
        """Add a height field.

        Args:
            heights: Heights of its samples, [rows, columns], from 0 to 1 of its relief; rows are
                along y, columns along x.
            size: Half of its sides along x and y, its relief, and the thickness of the ground below
                the relief, [4] m.
            middle: Middle of the field, at a height of 0 of its relief, [3] m.
            color: Color of the field.
        """
        rows, columns = heights.shape
        field = self.spec.add_hfield(
            name=f"field_{len(self.spec.hfields)}",
            size=size,
            nrow=rows,
            ncol=columns,
            userdata=heights.flatten(),
        )
        geom = self.body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_HFIELD,
            hfieldname=field.name,
            pos=np.add(middle, (*self.origin, 0.0)),
            rgba=color,
        )
        self.geometries.append(TileGeom(geom, color, field))

    def square(self, half: float, z: Range, color: Color = STONE) -> None:
        """Add a square slab around the middle."""
        self.box((-half, half), (-half, half), z, color)

    def ring(self, inner: float, outer: float, z: Range, color: Color = STONE) -> None:
        """Add a square ring around the middle, from half-width `inner` to `outer`."""
        sides = ((inner, outer), (-outer, -inner))
        # Two sides over the whole length, and two between them.
        for side in sides:
            self.box((-outer, outer), side, z, color)
        for side in sides:
            self.box(side, (-inner, inner), z, color)


def difficulty_of(level: int) -> float:
    """Return mjlab's difficulty in [0, 1] of a level from 1 to 10."""
    return (level - 1) / (LEVELS - 1)


@dataclass
class Tile:
    """Base of all tiles; `low` and `high` are sizes of obstacles in m at levels 1 and 10."""

    low: float = 0.0
    high: float = 0.0
    proportion: float = 1.0
    """Share of the robots, relative to the other kinds'."""
    flat_start: bool = False
    """True for a flat first level, for robots that cannot walk yet."""
    size: tuple[float, float] = (TILE, TILE)
    flat_patch_sampling: None = None

    def measure(self, difficulty: float) -> float:
        """Return the size of the obstacle at a difficulty in [0, 1], m."""
        # After a flat first level, levels 2 to 10 have the whole range.
        if self.flat_start:
            difficulty = (difficulty * (LEVELS - 1) - 1) / (LEVELS - 2)
        if difficulty < 0.0:
            return FLAT_RELIEF
        return self.low + difficulty * (self.high - self.low)

    def measure_at(self, level: int) -> float:
        """Return the size of the obstacle at a level from 1 to 10, m."""
        return self.measure(difficulty_of(level))

    def obstacle_end(self, measure: float) -> float:
        """Return where obstacles of size `measure`, m, end: half-width of a square around the
        start, m. By default they end with the tile.
        """
        return TILE / 2

    def function(
        self, difficulty: float, spec: mujoco.MjSpec, rng: np.random.Generator
    ) -> BuiltTile:
        """Build the tile with its corner at the origin, from where mjlab moves it."""
        builder = TileBuilder(spec)
        height = self.build(builder, self.measure(difficulty), rng)
        return BuiltTile(self.start(height), builder.geometries)

    def start(self, height: float) -> np.ndarray:
        """Return the start of a robot relative to the tile's corner, [3] m: the middle."""
        return np.array([TILE / 2, TILE / 2, height])

    def build(self, builder: TileBuilder, measure: float, rng: np.random.Generator) -> float:
        """Add the geoms of obstacles of size `measure`, m; returns the height of the start, m."""
        raise NotImplementedError


FLOOR = (-0.2, 0.0)
"""Range of a tile's floor along z, m."""


@dataclass
class Rough(Tile):
    """Random relief of `measure` metres on a 0.2 m grid; flat at level 1 and in the middle."""

    high: float = 0.06
    proportion: float = 2.0
    """Share of the robots, twice that of other kinds, as most ground is of this kind."""

    def build(self, builder: TileBuilder, measure: float, rng: np.random.Generator) -> float:
        """Add a height field; the start is at height 0."""
        relief = max(measure, 1e-3)
        nodes = int(TILE / 0.2) + 1
        heights = rng.uniform(0.0, 1.0, (nodes, nodes)) * (measure > 0)
        # The middle and the border are flat.
        middle = nodes // 2
        inside = slice(middle - 4, middle + 5)
        heights[inside, inside] = 0.0
        heights[0] = 0.0
        heights[-1] = 0.0
        heights[:, 0] = 0.0
        heights[:, -1] = 0.0
        builder.height_field(heights, (TILE / 2, TILE / 2, relief, 0.2))
        return 0.0


@dataclass
class Obstacles(Tile):
    """Scattered blocks up to `measure` metres high; the middle is free."""

    low: float = 0.05
    high: float = 0.25
    count: int = 24
    clear: float = 0.8
    """Half-width of the free square in the middle, m."""

    def build(self, builder: TileBuilder, measure: float, rng: np.random.Generator) -> float:
        """Add the blocks; robots start on the ground, at 0 m."""
        builder.square(TILE / 2, FLOOR)
        for _ in range(self.count):
            # Half of the sides along x and y.
            a, b = rng.uniform(0.2, 0.5, 2)
            x, y = self.place(a, b, rng)
            height = measure * rng.uniform(0.5, 1.0)
            builder.box((x - a, x + a), (y - b, y + b), (-0.1, height), ACCENT)
        return 0.0

    def place(self, a: float, b: float, rng: np.random.Generator) -> tuple[float, float]:
        """Draw the position of a block of half-sizes a, b that leaves the start free, m."""
        while True:
            radius = rng.uniform(1.2, 3.4)
            angle = rng.uniform(0.0, 2.0 * np.pi)
            x = radius * np.cos(angle)
            y = radius * np.sin(angle)
            if abs(x) - a > self.clear or abs(y) - b > self.clear:
                return x, y


@dataclass
class StairsTile(Tile):
    """Pyramid stairs of rise `measure`, down from a summit or up out of a pit."""

    low: float = 0.05
    high: float = 0.23
    tread: float = 0.30
    """Depth of a step, m."""
    steps: int = 9
    """Number of steps."""
    landing: float = 1.2
    """Half-width of the square at the bottom of a pit, m; on a summit it is a tread wider."""
    descend: bool = True
    """True for a summit, from which stairs go down."""

    def build(self, builder: TileBuilder, measure: float, rng: np.random.Generator) -> float:
        """Add the steps; returns the height of the summit or of the pit, m."""
        edge = self.landing + self.steps * self.tread
        top = self.steps * measure
        colors = [(step, STONE if step % 2 else STEEL) for step in range(1, self.steps + 1)]
        if self.descend:
            # Squares on top of each other.
            builder.square(TILE / 2, FLOOR)
            for step, color in colors:
                builder.square(edge - (step - 1) * self.tread, (0.0, step * measure), color)
            return top
        # Rings around a pit.
        builder.square(self.landing, (-top - 0.2, -top), STEEL)
        for step, color in colors:
            inner = self.landing + (step - 1) * self.tread
            builder.ring(inner, inner + self.tread, (-top - 0.2, -top + step * measure), color)
        builder.ring(edge, TILE / 2, (-top - 0.2, 0.0))
        return -top

    def obstacle_end(self, measure: float) -> float:
        """Return where the last edge is, m."""
        # The last step out of a pit is level with the ground around it.
        edges = self.steps if self.descend else self.steps - 1
        return self.landing + edges * self.tread


LANDING = 0.6
"""Smallest width of the ground outside the last of several gaps, m."""


@dataclass
class GapTile(Tile):
    """An island surrounded by rings `measure` metres wide and 1 m deep."""

    low: float = 0.10
    high: float = 0.70
    island: float = 1.2
    """Half-width of the island, m."""
    ground: float | None = None
    """Width of the ground between two gaps, m; None: a single gap."""
    landing: float = LANDING
    """Smallest width of the ground outside the last gap, m."""
    depth: float = 1.0
    """Depth of the gaps, m."""

    def build(self, builder: TileBuilder, measure: float, rng: np.random.Generator) -> float:
        """Add the island and the ground outside each gap; the start is at height 0."""
        builder.square(self.island, (-self.depth, 0.0))
        *between, last = self.far_edges(measure)
        for inner in between:
            builder.ring(inner, inner + (self.ground or 0.0), (-self.depth, 0.0))
        builder.ring(last, TILE / 2, (-self.depth, 0.0))
        builder.square(TILE / 2, (-self.depth - 0.2, -self.depth), PIT)
        return 0.0

    def far_edges(self, measure: float) -> list[float]:
        """Return the half-widths at which the gaps end, the nearest first, m."""
        edges = [self.island + measure]
        if self.ground is None:
            return edges
        step = self.ground + measure
        while edges[-1] + self.ground + measure + self.landing <= TILE / 2:
            edges.append(edges[-1] + step)
        return edges

    def obstacle_end(self, measure: float) -> float:
        """Return where the last gap ends, m."""
        return self.far_edges(measure)[-1]


@dataclass
class PlatformTile(Tile):
    """Raised rings of height `measure` to climb onto and down from."""

    low: float = 0.05
    high: float = 0.50
    rings: tuple[tuple[float, float], ...] = ((1.4, 2.8),)
    """Inner and outer half-width of each ring, m."""

    def build(self, builder: TileBuilder, measure: float, rng: np.random.Generator) -> float:
        """Add the floor and the rings; the start is at height 0."""
        builder.square(TILE / 2, FLOOR)
        for inner, outer in self.rings:
            builder.ring(inner, outer, (-0.1, measure), ACCENT)
        return 0.0

    def obstacle_end(self, measure: float) -> float:
        """Return where the last ring ends, m."""
        return self.rings[-1][1]


@dataclass
class Barrier(Tile):
    """Base of the tiles that no robot can leave."""

    clear: float = 1.6
    """Half-width of the ground around the start, m."""


@dataclass
class Wall(Barrier):
    """A wall `measure` metres high around the start."""

    low: float = 0.7
    high: float = 1.2
    thickness: float = 0.4
    """Thickness of the wall, m."""

    def build(self, builder: TileBuilder, measure: float, rng: np.random.Generator) -> float:
        """Add floor and wall; the start is at height 0."""
        builder.square(TILE / 2, FLOOR)
        builder.ring(self.clear, self.clear + self.thickness, (-0.1, measure), ACCENT)
        return 0.0


@dataclass
class Ledge(Barrier):
    """An island with a drop of `measure` metres to all sides."""

    low: float = 0.8
    high: float = 1.5

    def build(self, builder: TileBuilder, measure: float, rng: np.random.Generator) -> float:
        """Add the island and the ground below; the start is at height 0."""
        builder.square(self.clear, (-measure, 0.0))
        builder.square(TILE / 2, (-measure - 0.2, -measure), PIT)
        return 0.0


def barriers() -> dict[str, Barrier]:
    """Return all kinds of tile that no robot can leave, by name."""
    return {"wall": Wall(), "ledge": Ledge()}


def tiles() -> dict[str, Tile]:
    """Return all other kinds of tile by name, in the order of columns."""
    return {
        "rough": Rough(),
        "obstacles": Obstacles(),
        "stairs_up": StairsTile(descend=False),
        "stairs_down": StairsTile(descend=True),
        "gap": GapTile(),
        "platform": PlatformTile(),
    }


def dense_tiles() -> dict[str, Tile]:
    """Return the same kinds with two to three times as many edges, and a flat first level.

    On `tiles`, 65 to 91 % of the way out of a gap or platform tile is plain ground.
    """
    return {
        "rough": Rough(),
        "obstacles": Obstacles(count=40, flat_start=True),
        "stairs_up": StairsTile(descend=False, flat_start=True),
        "stairs_down": StairsTile(descend=True, flat_start=True),
        "gap": GapTile(island=0.9, ground=0.9, flat_start=True),
        "platform": PlatformTile(rings=((0.9, 1.7), (2.4, 3.2)), flat_start=True),
    }


def find_tile(kind: str, level: int) -> Tile:
    """Find a kind of tile that has a level.

    Args:
        kind: Key of `tiles`, or `stairs`, which go down.
        level: Level from 1 to 10.

    Raises:
        RenetError: There is no such kind or level.
    """
    kinds = {"stairs": StairsTile(descend=True), **tiles()}
    # Flat ground is no tile, but all callers know it.
    if kind not in kinds:
        raise unknown_name("terrain", kind, ("flat", *kinds))
    if not 1 <= level <= LEVELS:
        raise RenetError(f"terrain level must be 1 to {LEVELS}, got {level}")
    return kinds[kind]
