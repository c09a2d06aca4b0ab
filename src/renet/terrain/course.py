"""Courses: several obstacles in a row, walked along x.

A `Course` is one tile. Its obstacles are as wide as the tile, so that robots cannot walk around
them. Heights add up: the ground after stairs is higher or lower than the ground before them. The
benchmark draws random courses (`renet.evaluation.benchmark.episodes`), and
`benchmarks/paper/kilometre.py` builds the paper's long walk.

Positions along a course and heights are in metres from the start of the robot.
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
)

COURSE_WIDTH = 18.0
"""Width of a course, m. It is wide because robots do not walk straight."""
GROUND_BEFORE = 1.0
"""Ground behind the start, m."""
GROUND_AFTER = 2.5
"""Ground after the last obstacle, m."""
PIT_DEPTH = 1.0
"""Depth of gaps, m."""

Profile = list[tuple[float, float]]
"""Corners (position, height) of the line along which feet walk, m."""


class Strip(TileBuilder):
    """Builder of a course's tile. x is 0 at the robot's start, y on the middle line."""

    def __init__(self, spec: mujoco.MjSpec, bottom: float) -> None:
        """Initialize an empty tile.

        Args:
            spec: Scene of the tile.
            bottom: Height of the lower faces of all ground, m.
        """
        super().__init__(spec, (GROUND_BEFORE, COURSE_WIDTH / 2))
        self.bottom = bottom

    def ground(self, start: float, end: float, top: float, color: Color = STONE) -> None:
        """Add ground over the whole width, between two x, with its surface at `top`, m."""
        self.box((start, end), (-COURSE_WIDTH / 2, COURSE_WIDTH / 2), (self.bottom, top), color)

    def obstacle(self, x: Range, z: Range, color: Color = ACCENT, y: Range | None = None) -> None:
        """Add a box on the ground, given its ranges in m; by default it has the whole width."""
        box = self.box(x, y or (-COURSE_WIDTH / 2, COURSE_WIDTH / 2), z, color)
        box.group = OBSTACLE_GROUP

    def slab(self, start: tuple[float, float], end: tuple[float, float], thick: float) -> None:
        """Add a tilted plate over the whole width.

        Args:
            start: Point (x, z) at which its upper face begins, m.
            end: Point (x, z) at which its upper face ends, m.
            thick: Thickness, m.
        """
        run = end[0] - start[0]
        rise = end[1] - start[1]
        angle = math.atan2(rise, run)
        # The middle of the plate is half its thickness below the middle of its upper face, along
        # the normal.
        x = (start[0] + end[0]) / 2 + thick / 2 * math.sin(angle)
        z = (start[1] + end[1]) / 2 - thick / 2 * math.cos(angle)
        half = (math.hypot(run, rise) / 2, COURSE_WIDTH / 2, thick / 2)
        # Turned about y, with the end up.
        quaternion = (math.cos(angle / 2), 0.0, -math.sin(angle / 2), 0.0)
        plate = self.turned_box((x, 0.0, z), half, quaternion)
        plate.group = OBSTACLE_GROUP


@dataclass(frozen=True)
class Obstacle:
    """Base of the obstacles across a course."""

    kind: ClassVar[str]

    @property
    def extent(self) -> float:
        """Length along the course, m."""
        raise NotImplementedError

    @property
    def climb(self) -> float:
        """Height of the ground behind the obstacle above that in front of it, m."""
        return 0.0

    @property
    def lowest(self) -> float:
        """Height of the lowest surface above the ground in front of the obstacle, m."""
        return min(0.0, self.climb)

    def profile(self) -> Profile:
        """Return the line along which feet walk, from the first edge at (0, 0)."""
        return [(0.0, 0.0), (self.extent, self.climb)]

    def build(self, strip: Strip, x: float, z: float, rng: np.random.Generator) -> None:
        """Add the obstacle's geoms, and the ground below it, to a course.

        Args:
            strip: Builder of the course's tile.
            x: Position of the obstacle's first edge, m.
            z: Height of the ground in front of it, m.
            rng: Generator of its random numbers.
        """
        raise NotImplementedError

    def record(self) -> dict[str, Any]:
        """Return kind and sizes for JSON."""
        return {"kind": self.kind} | asdict(self)


class Stretch(Obstacle):
    """Base of the obstacles whose `length` is a field."""

    length: float
    """Length along the course, m."""

    @property
    def extent(self) -> float:
        """Length along the course, m."""
        return self.length


@dataclass(frozen=True)
class Plain(Stretch):
    """Flat ground, for stretches on which only the camera fails."""

    kind: ClassVar[str] = "plain"
    length: float

    def build(self, strip: Strip, x: float, z: float, rng: np.random.Generator) -> None:
        """Add the ground."""
        strip.ground(x, x + self.length, z)


@dataclass(frozen=True)
class Gap(Obstacle):
    """A gap 1 m deep."""

    kind: ClassVar[str] = "gap"
    width: float
    """Width of the gap along the course, m."""

    @property
    def extent(self) -> float:
        """Width of the gap, m."""
        return self.width

    @property
    def lowest(self) -> float:
        """Height of the gap's floor, m."""
        return -PIT_DEPTH

    def build(self, strip: Strip, x: float, z: float, rng: np.random.Generator) -> None:
        """Add the gap's floor."""
        strip.ground(x, x + self.width, z - PIT_DEPTH, PIT)


@dataclass(frozen=True)
class Platform(Stretch):
    """A box to climb onto and down from."""

    kind: ClassVar[str] = "platform"
    height: float
    """Height of the top, m."""
    length: float

    def build(self, strip: Strip, x: float, z: float, rng: np.random.Generator) -> None:
        """Add the box, on ground."""
        strip.ground(x, x + self.length, z)
        strip.obstacle((x, x + self.length), (z - 0.1, z + self.height))


@dataclass(frozen=True)
class Stairs(Obstacle):
    """A flight of stairs, up or down."""

    kind: ClassVar[str] = "stairs"
    rise: float
    """Height of a step, m; negative for stairs that go down."""
    tread: float
    """Depth of a step, m."""
    steps: int
    """Number of steps."""

    @property
    def extent(self) -> float:
        """Distance from the edge of the first step to the end of the last one, m."""
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
            # Downstairs the first tread is one step below the ground in front of the stairs, and
            # the last one is the ground behind them.
            top = z + self.rise * (step + 1)
            if top > floor + 1e-6:
                color = STONE if step % 2 else STEEL
                strip.obstacle((start, start + self.tread), (floor - 0.1, top), color)


@dataclass(frozen=True)
class Blocks(Stretch):
    """A field of scattered blocks."""

    kind: ClassVar[str] = "blocks"
    height: float
    """Largest height of a block, m; the smallest is half of it."""
    length: float
    density: float = 0.7
    """Number of blocks per square metre; each has sides of 0.4 to 1.0 m."""

    def build(self, strip: Strip, x: float, z: float, rng: np.random.Generator) -> None:
        """Add the blocks, on ground."""
        strip.ground(x, x + self.length, z)
        for _ in range(round(self.density * COURSE_WIDTH * self.length)):
            half_x, half_y = rng.uniform(0.2, 0.5, 2)
            middle = x + rng.uniform(half_x, self.length - half_x)
            aside = rng.uniform(-COURSE_WIDTH / 2 + half_y, COURSE_WIDTH / 2 - half_y)
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
        """Height of the landing, m."""
        return self.run * math.tan(math.radians(self.slope))

    @property
    def extent(self) -> float:
        """Length of both ramps and the landing, m."""
        return 2 * self.run + self.landing

    def profile(self) -> Profile:
        """Return the line up, along the landing, and down."""
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
        # The landing begins where the ramp up ends.
        first = x + self.run
        last = first + self.landing
        top = z + self.height
        strip.obstacle((first, last), (z - 0.1, top))
        strip.slab((x, z), (first, top), thick=0.1)
        strip.slab((last, top), (x + self.extent, z), thick=0.1)


@dataclass
class Course(Tile):
    """Obstacles in a row with ground between them."""

    obstacles: tuple[Obstacle, ...] = ()
    spaces: tuple[float, ...] = ()
    """Length of the ground in front of each obstacle, m; the first counts from the start."""
    seed: int = 0
    """Seed of the obstacles' random numbers, which do not depend on other courses of a scene."""

    def __post_init__(self) -> None:
        if len(self.obstacles) != len(self.spaces):
            raise ValueError(f"{len(self.obstacles)} obstacles need as many spaces")

    def placements(self) -> Iterator[tuple[Obstacle, float, float]]:
        """Yield each obstacle with the position of its first edge and the height before it, m."""
        position = 0.0
        height = 0.0
        for obstacle, space in zip(self.obstacles, self.spaces, strict=True):
            position += space
            yield obstacle, position, height
            position += obstacle.extent
            height += obstacle.climb

    @property
    def edges(self) -> np.ndarray:
        """First and last edge of each obstacle, [obstacles, 2] m."""
        edges = [(x, x + obstacle.extent) for obstacle, x, _ in self.placements()]
        # A course without obstacles has an array of shape [0, 2].
        return np.array(edges).reshape(-1, 2)

    @property
    def length(self) -> float:
        """Length of the whole tile, m."""
        extent = sum(obstacle.extent for obstacle in self.obstacles)
        return GROUND_BEFORE + sum(self.spaces) + extent + GROUND_AFTER

    @property
    def profile(self) -> np.ndarray:
        """Corners (position, height) of the line along which feet walk, [corners, 2] m.

        Across a gap it stays at the height of the edges, on a platform at that of the ground.
        """
        corners = [(-GROUND_BEFORE, 0.0)]
        for obstacle, x, z in self.placements():
            for along, up in obstacle.profile():
                corners.append((x + along, z + up))
        return np.array(corners)

    def walking_height(self, positions: np.ndarray) -> np.ndarray:
        """Return the height of `profile`, m, at positions of any shape, m."""
        corners = self.profile
        return np.interp(positions, corners[:, 0], corners[:, 1])

    def function(
        self, difficulty: float, spec: mujoco.MjSpec, rng: np.random.Generator
    ) -> BuiltTile:
        """Build the course with its corner at the origin, from where mjlab moves it."""
        # All ground reaches down to the same depth, below the lowest surface.
        lowest = 0.0
        for obstacle, _, z in self.placements():
            lowest = min(lowest, z + obstacle.lowest)
        strip = Strip(spec, bottom=lowest - 0.2)

        # The ground in front of each obstacle, and the obstacle.
        own_rng = np.random.default_rng(self.seed)
        position = -GROUND_BEFORE
        height = 0.0
        for obstacle, x, z in self.placements():
            strip.ground(position, x, z)
            obstacle.build(strip, x, z, own_rng)
            position = x + obstacle.extent
            height = z + obstacle.climb
        # A course beside a longer one has ground up to the end of its tile.
        strip.ground(position, self.size[0] - GROUND_BEFORE, height)
        return BuiltTile(np.array([GROUND_BEFORE, COURSE_WIDTH / 2, 0.0]), strip.geometries)
