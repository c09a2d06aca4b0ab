"""Courses: several obstacles in a row, walked along x.

A `Course` is one tile. Its obstacles are as wide as the tile, so that none can be walked around,
and heights add up: what follows stairs lies higher or lower than what is before them. The benchmark
draws its courses (`renet.evaluation.benchmark.episodes`); `benchmarks/paper/kilometre.py` lays out
the paper's long walk.

Positions along a course count from where the robot starts, in metres; so do heights.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any, ClassVar

import mujoco
import numpy as np

from renet.terrain.tiles import (
    ACCENT,
    OBSTACLE_GROUP,
    PIT,
    STEEL,
    STONE,
    BuiltTile,
    Color,
    Range,
    Tile,
    TileBuilder,
    TileGeom,
)

WIDTH = 18.0
"""Width of a course, m: robots may walk askew."""
BEFORE = 1.0
"""Ground behind the start, m."""
AFTER = 2.5
"""Ground after the last obstacle, m."""
PIT_DEPTH = 1.0
"""Depth of gaps, m."""

Profile = list[tuple[float, float]]
"""Corners (position, height) of the line on which feet walk, m."""


class Strip(TileBuilder):
    """Builds a course's tile; y is 0 on the middle line."""

    def __init__(self, spec: mujoco.MjSpec, bottom: float) -> None:
        """Begin a tile; bottom: height of the lower faces of all ground, m."""
        super().__init__(spec, (BEFORE, WIDTH / 2))
        self.bottom = bottom

    def ground(self, start: float, end: float, top: float, color: Color = STONE) -> None:
        """Add ground over the whole width."""
        self.box((start, end), (-WIDTH / 2, WIDTH / 2), (self.bottom, top), color)

    def obstacle(self, x: Range, z: Range, color: Color = ACCENT, y: Range | None = None) -> None:
        """Add a box that stands on the ground; y: its sides, by default the course's."""
        box = self.box(x, y or (-WIDTH / 2, WIDTH / 2), z, color)
        box.group = OBSTACLE_GROUP

    def slab(self, start: tuple[float, float], end: tuple[float, float], thick: float) -> None:
        """Add a tilted plate over the whole width, whose upper face joins two points (x, z)."""
        run, rise = end[0] - start[0], end[1] - start[1]
        angle = math.atan2(rise, run)
        # From the middle of the upper face half the thickness down along its normal.
        x = (start[0] + end[0]) / 2 + thick / 2 * math.sin(angle)
        z = (start[1] + end[1]) / 2 - thick / 2 * math.cos(angle)
        geom = self.body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=(math.hypot(run, rise) / 2, WIDTH / 2, thick / 2),
            pos=(self.origin[0] + x, self.origin[1], z),
            quat=(math.cos(angle / 2), 0.0, -math.sin(angle / 2), 0.0),
            rgba=STONE,
        )
        geom.group = OBSTACLE_GROUP
        self.geometries.append(TileGeom(geom, STONE))


@dataclass(frozen=True)
class Obstacle:
    """Base of what lies across a course."""

    kind: ClassVar[str]

    @property
    def extent(self) -> float:
        """Length along the course, m."""
        raise NotImplementedError

    @property
    def climb(self) -> float:
        """Height of the ground after it over that before it, m."""
        return 0.0

    @property
    def lowest(self) -> float:
        """Lowest surface relative to the ground before it, m."""
        return min(0.0, self.climb)

    def profile(self) -> Profile:
        """The line on which feet walk, from its first edge and the ground before it."""
        return [(0.0, 0.0), (self.extent, self.climb)]

    def build(self, strip: Strip, x: float, z: float, rng: np.random.Generator) -> None:
        """Add its geoms and the ground below it.

        Args:
            strip: to add them to. x: position of its first edge, m.
            z: height of the ground before it, m. rng: for what is random in it.
        """
        raise NotImplementedError

    def record(self) -> dict[str, Any]:
        """Its kind and sizes, for JSON."""
        return {"kind": self.kind} | asdict(self)


@dataclass(frozen=True)
class Plain(Obstacle):
    """Flat ground, for stretches on which only the camera fails."""

    kind: ClassVar[str] = "plain"
    length: float

    @property
    def extent(self) -> float:
        """Length along the course, m."""
        return self.length

    def build(self, strip: Strip, x: float, z: float, rng: np.random.Generator) -> None:
        """Add the ground."""
        strip.ground(x, x + self.length, z)


@dataclass(frozen=True)
class Gap(Obstacle):
    """A gap 1 m deep."""

    kind: ClassVar[str] = "gap"
    width: float
    """m"""

    @property
    def extent(self) -> float:
        """Width, m."""
        return self.width

    @property
    def lowest(self) -> float:
        """The floor of the gap, m."""
        return -PIT_DEPTH

    def build(self, strip: Strip, x: float, z: float, rng: np.random.Generator) -> None:
        """Add the gap's floor."""
        strip.ground(x, x + self.width, z - PIT_DEPTH, PIT)


@dataclass(frozen=True)
class Platform(Obstacle):
    """A box to climb onto and down from."""

    kind: ClassVar[str] = "platform"
    height: float
    """m"""
    length: float
    """Of its top, m."""

    @property
    def extent(self) -> float:
        """Length of the top, m."""
        return self.length

    def build(self, strip: Strip, x: float, z: float, rng: np.random.Generator) -> None:
        """Add the box, on ground."""
        strip.ground(x, x + self.length, z)
        strip.obstacle((x, x + self.length), (z - 0.1, z + self.height))


@dataclass(frozen=True)
class Stairs(Obstacle):
    """A flight of stairs, up or down."""

    kind: ClassVar[str] = "stairs"
    rise: float
    """Height of a step, m; below zero stairs go down."""
    tread: float
    """Depth of a step, m."""
    steps: int

    @property
    def extent(self) -> float:
        """From the first step's edge to the last one's end, m."""
        return self.tread * self.steps

    @property
    def climb(self) -> float:
        """Height of the flight, m."""
        return self.rise * self.steps

    def build(self, strip: Strip, x: float, z: float, rng: np.random.Generator) -> None:
        """Add the steps, on ground as high as the lower end."""
        floor = min(z, z + self.climb)
        strip.ground(x, x + self.extent, floor)
        for step in range(self.steps):
            start = x + step * self.tread
            # Down: the first tread lies one rise below the ground before the stairs.
            top = z + self.rise * (step + 1)
            if top > floor + 1e-6:
                color = STONE if step % 2 else STEEL
                strip.obstacle((start, start + self.tread), (floor - 0.1, top), color)


@dataclass(frozen=True)
class Blocks(Obstacle):
    """A field of scattered blocks."""

    kind: ClassVar[str] = "blocks"
    height: float
    """Of the highest block; the lowest one has half of it, m."""
    length: float
    """Of the field, m."""
    density: float = 0.7
    """Blocks on a square metre; each has sides of 0.4 to 1.0 m."""

    @property
    def extent(self) -> float:
        """Length of the field, m."""
        return self.length

    def build(self, strip: Strip, x: float, z: float, rng: np.random.Generator) -> None:
        """Add the blocks, on ground."""
        strip.ground(x, x + self.length, z)
        for _ in range(round(self.density * WIDTH * self.length)):
            half_x, half_y = rng.uniform(0.2, 0.5, 2)
            middle = x + rng.uniform(half_x, self.length - half_x)
            aside = rng.uniform(-WIDTH / 2 + half_y, WIDTH / 2 - half_y)
            top = z + self.height * rng.uniform(0.5, 1.0)
            strip.obstacle(
                (middle - half_x, middle + half_x),
                (z - 0.1, top),
                y=(aside - half_y, aside + half_y),
            )


@dataclass(frozen=True)
class Ramp(Obstacle):
    """A ramp up, a landing, and a ramp down."""

    kind: ClassVar[str] = "ramp"
    slope: float
    """Angle of both ramps, degrees."""
    run: float
    """Length of each ramp on the ground, m."""
    landing: float = 0.6
    """Length of the top, m."""

    @property
    def height(self) -> float:
        """Of the landing, m."""
        return self.run * math.tan(math.radians(self.slope))

    @property
    def extent(self) -> float:
        """Both ramps and the landing, m."""
        return 2 * self.run + self.landing

    def profile(self) -> Profile:
        """Up, along the landing, and down."""
        top = self.height
        return [
            (0.0, 0.0),
            (self.run, top),
            (self.run + self.landing, top),
            (self.extent, 0.0),
        ]

    def build(self, strip: Strip, x: float, z: float, rng: np.random.Generator) -> None:
        """Add the landing and two tilted plates, on ground."""
        strip.ground(x, x + self.extent, z)
        first, last = x + self.run, x + self.run + self.landing
        strip.obstacle((first, last), (z - 0.1, z + self.height))
        strip.slab((x, z), (first, z + self.height), thick=0.1)
        strip.slab((last, z + self.height), (x + self.extent, z), thick=0.1)


OBSTACLES: dict[str, type[Obstacle]] = {
    kind.kind: kind for kind in (Plain, Gap, Platform, Stairs, Blocks, Ramp)
}
"""Every kind of obstacle by its name."""


@dataclass
class Course(Tile):
    """Obstacles in a row with ground between them."""

    obstacles: tuple[Obstacle, ...] = ()
    spaces: tuple[float, ...] = ()
    """Ground before each obstacle, m; the first is the way from the start."""
    seed: int = 0
    """Of what is random in the obstacles, whatever course is built beside it."""

    def __post_init__(self) -> None:
        if len(self.obstacles) != len(self.spaces):
            raise ValueError(f"{len(self.obstacles)} obstacles need as many spaces")

    def laid_out(self) -> Iterator[tuple[Obstacle, float, float]]:
        """Each obstacle, the position of its first edge, and the height of the ground before it."""
        position, height = 0.0, 0.0
        for obstacle, space in zip(self.obstacles, self.spaces, strict=True):
            position += space
            yield obstacle, position, height
            position += obstacle.extent
            height += obstacle.climb

    @property
    def edges(self) -> np.ndarray:
        """First and last edge of each obstacle, [obstacles, 2] m."""
        return np.array([(x, x + o.extent) for o, x, _ in self.laid_out()]).reshape(-1, 2)

    @property
    def length(self) -> float:
        """Length of the whole tile, m."""
        return BEFORE + sum(self.spaces) + sum(o.extent for o in self.obstacles) + AFTER

    @property
    def profile(self) -> np.ndarray:
        """Corners (position, height) of the line on which feet walk, [corners, 2] m.

        Over a gap it stays at the height of the edges, on a platform at that of the ground.
        """
        corners = [(-BEFORE, 0.0)]
        for obstacle, x, z in self.laid_out():
            corners += [(x + along, z + up) for along, up in obstacle.profile()]
        return np.array(corners)

    def walking_height(self, positions: np.ndarray) -> np.ndarray:
        """Height of `profile` at positions of any shape, m."""
        corners = self.profile
        return np.interp(positions, corners[:, 0], corners[:, 1])

    def function(
        self, difficulty: float, spec: mujoco.MjSpec, rng: np.random.Generator
    ) -> BuiltTile:
        """Build the course with its corner at the origin, from where mjlab moves it."""
        lowest = min((z + o.lowest for o, _, z in self.laid_out()), default=0.0)
        strip = Strip(spec, bottom=min(lowest, 0.0) - 0.2)
        own = np.random.default_rng(self.seed)
        position, height = -BEFORE, 0.0
        for obstacle, x, z in self.laid_out():
            strip.ground(position, x, z)
            obstacle.build(strip, x, z, own)
            position = x + obstacle.extent
            height = z + obstacle.climb
        # Courses beside longer ones go on to the end of their tile.
        strip.ground(position, self.size[0] - BEFORE, height)
        return BuiltTile(np.array([BEFORE, WIDTH / 2, 0.0]), strip.geometries)
