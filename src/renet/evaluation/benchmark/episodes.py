"""Episodes of the benchmark: 200, each drawn from the version's seed and its own number.

An episode is a course of two or three obstacles, the commands on the way, and a fault of the
camera. It depends on nothing else: neither on other episodes nor on the policy.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from renet.evaluation.benchmark.families import (
    DRAWN_SEVERITIES,
    GLASS,
    LIES,
    LOUD,
    Families,
    SealedFaults,
    draw_fault,
    fault_of,
    level_at,
)
from renet.faults.base import FOREVER
from renet.terrain.course import Blocks, Course, Gap, Obstacle, Platform, Ramp, Stairs

SEED = 3
"""Seed of version 3. Results with another seed are no results of the benchmark."""
EPISODES = 200
"""Number of episodes of the full set."""
QUICK_EPISODES = 20
"""Number of episodes of the quick set, the first of the full one."""
SEALED_EPISODES = 40
"""Number of further episodes with sealed faults; they are numbered after the others."""
EPISODES_PER_BLOCK = 10
"""Number of episodes simulated side by side; the robots' bodies are drawn for a block at once."""

_STRANGER_PERIOD = 5
"""Every fifth episode is walked by a stranger, see `stranger.py`."""
_RUN_UP = (2.0, 2.8)
"""Range of the ground before the first obstacle, m: no obstacle is in sight at the start."""
_SPACE = (0.5, 1.5)
"""Range of the ground between two obstacles, m."""
_SPEEDS = (0.3, 1.0)
"""Range of commanded speeds, m/s."""
_LARGEST_HEADING = np.radians(30.0)
"""Largest angle between a commanded heading and the course, rad."""
_STOP_SECONDS = (1.0, 2.0)
"""Range of the time for which a robot is commanded to stand, s."""
SIGHT = 1.6
"""Distance at which an edge comes into sight, m."""
_DURATIONS = (0.5, 8.0)
"""Range of a fault's duration, s, log-uniform; half of all faults last to the end instead."""


@dataclass(frozen=True)
class Episode:
    """One course, its commands and its fault."""

    number: int
    """Number of the episode, from 0."""
    obstacles: tuple[Obstacle, ...]
    """Obstacles of the course, in their order."""
    spaces: tuple[float, ...]
    """Ground before each obstacle, m."""
    speed: float
    """Commanded speed, m/s."""
    headings: tuple[float, float]
    """Commanded headings before and after the turn, rad from straight along the course."""
    turn_at: float
    """Position at which the second heading is commanded, m."""
    stop_at: float
    """Position at which the robot is commanded to stand, m."""
    stop_seconds: float
    """Time for which it stands, s."""
    family: str
    """Family of the fault."""
    lie: bool
    """True if the fault leaves images that look healthy."""
    fault: str
    """Name of the fault."""
    level: float
    """Strength of the fault, in its own unit."""
    onset: float
    """Position at which the camera begins to fail, m."""
    duration: float
    """Time for which it fails, s."""
    stranger: bool
    """True if the robot is a stranger: one that no policy was trained on (`stranger.py`)."""

    @property
    def course(self) -> Course:
        """The course, a tile."""
        return Course(obstacles=self.obstacles, spaces=self.spaces, seed=self.number)

    @property
    def name(self) -> str:
        """Name of the course's tile."""
        return f"episode_{self.number}"

    @property
    def seconds(self) -> float:
        """Time limit, s: half the commanded speed over the whole course, and the stop."""
        way = sum(self.spaces) + sum(obstacle.extent for obstacle in self.obstacles)
        return 2.0 * (way + 1.0) / self.speed + self.stop_seconds + 3.0

    def record(self) -> dict[str, Any]:
        """Return the episode as a dictionary for JSON."""
        return vars(self) | {"obstacles": [obstacle.record() for obstacle in self.obstacles]}


def draw_episodes(
    numbers: range, seed: int = SEED, sealed: SealedFaults | None = None
) -> list[Episode]:
    """Draw the episodes of a range of numbers.

    Args:
        numbers: Numbers of the episodes; those from `EPISODES` on have sealed faults.
        seed: Seed of the draw.
        sealed: The sealed families; raises ValueError if they are needed and missing.
    """
    return [draw_episode(number, seed, sealed) for number in numbers]


def draw_episode(number: int, seed: int = SEED, sealed: SealedFaults | None = None) -> Episode:
    """Draw one episode; see `draw_episodes`."""
    # The order of the draws is part of the version.
    rng = np.random.default_rng([seed, number])
    families, lie = _families(number, sealed)
    family, fault = draw_fault(rng, families)
    level = level_at(fault_of(fault, sealed), int(rng.choice(DRAWN_SEVERITIES)))
    count = int(rng.integers(2, 4))
    obstacles = [draw_obstacle(rng) for _ in range(count)]
    spaces = [float(rng.uniform(*_RUN_UP)), *rng.uniform(*_SPACE, count - 1).tolist()]
    # Index of the obstacle before which the camera fails.
    failing = draw_failing(rng, obstacles)
    if family == GLASS and isinstance(obstacles[failing], Gap):
        # A gap has no surface that could be glass.
        obstacles[failing] = draw_platform(rng)
    # Robots turn and stop 0.6 m from the start, or in the middle between two obstacles.
    course = Course(obstacles=tuple(obstacles), spaces=tuple(spaces))
    starts, ends = course.edges.T
    middles = np.concatenate(([0.6], (ends[:-1] + starts[1:]) / 2))
    # The second heading points to the other side of the course, so that every turn is a real one.
    first = float(rng.uniform(-_LARGEST_HEADING, _LARGEST_HEADING))
    second = float(-np.sign(first) * rng.uniform(0.0, _LARGEST_HEADING))
    onset = float(rng.uniform(starts[failing] - SIGHT, starts[failing]))
    return Episode(
        number=number,
        obstacles=tuple(obstacles),
        spaces=tuple(spaces),
        speed=float(rng.uniform(*_SPEEDS)),
        headings=(first, second),
        turn_at=float(rng.choice(middles)),
        stop_at=float(rng.choice(middles)),
        stop_seconds=float(rng.uniform(*_STOP_SECONDS)),
        family=family,
        lie=lie,
        fault=fault,
        level=level,
        onset=onset,
        duration=draw_duration(rng),
        stranger=number % _STRANGER_PERIOD == _STRANGER_PERIOD - 1,
    )


def _families(number: int, sealed: SealedFaults | None) -> tuple[Families, bool]:
    """Return the families that an episode's fault is drawn from, and True if they are lies.

    Every second episode draws a lie, and every sealed one.
    """
    if number >= EPISODES:
        if sealed is None:
            raise ValueError(f"episode {number} needs the sealed families")
        return sealed.families, True
    lie = number % 2 == 1
    return (LIES if lie else LOUD), lie


def draw_failing(rng: np.random.Generator, obstacles: list[Obstacle]) -> int:
    """Draw the index of the obstacle before which the camera fails.

    It is a gap or a platform, which need the camera, if the course has one.
    """
    indices = []
    for index, obstacle in enumerate(obstacles):
        if isinstance(obstacle, (Gap, Platform)):
            indices.append(index)
    return int(rng.choice(indices or range(len(obstacles))))


def draw_duration(rng: np.random.Generator) -> float:
    """Draw the time for which a camera fails, s."""
    seconds = float(np.exp(rng.uniform(*np.log(_DURATIONS))))
    return FOREVER if rng.random() < 0.5 else seconds


def draw_obstacle(rng: np.random.Generator) -> Obstacle:
    """Draw an obstacle: its kind, then its sizes uniformly.

    Half of all are gaps and platforms, which cannot be crossed blind; many of the others can.
    """
    # The halves do not depend on the number of kinds in each.
    if rng.random() < 0.5:
        draws = (draw_gap, draw_platform)
    else:
        draws = (draw_stairs, draw_stairs_down, draw_blocks, draw_ramp)
    return draws[rng.integers(len(draws))](rng)


def draw_gap(rng: np.random.Generator) -> Gap:
    """Draw a gap of 0.3 to 0.9 m."""
    return Gap(float(rng.uniform(0.3, 0.9)))


def draw_platform(rng: np.random.Generator) -> Platform:
    """Draw a platform 0.2 to 0.6 m high and 0.8 to 1.6 m long."""
    return Platform(float(rng.uniform(0.2, 0.6)), float(rng.uniform(0.8, 1.6)))


def draw_stairs(rng: np.random.Generator, sign: int = 1) -> Stairs:
    """Draw stairs of three to six steps, 8 to 24 cm high and 25 to 40 cm deep; -1 is down."""
    rise = rng.uniform(0.08, 0.24)
    tread = rng.uniform(0.25, 0.40)
    return Stairs(sign * float(rise), float(tread), int(rng.integers(3, 7)))


def draw_stairs_down(rng: np.random.Generator) -> Stairs:
    """Draw stairs down, with the sizes of stairs up."""
    return draw_stairs(rng, -1)


def draw_blocks(rng: np.random.Generator) -> Blocks:
    """Draw 1.2 to 2 m of blocks, the highest of which are 10 to 25 cm."""
    return Blocks(float(rng.uniform(0.10, 0.25)), float(rng.uniform(1.2, 2.0)))


def draw_ramp(rng: np.random.Generator) -> Ramp:
    """Draw ramps of 10 to 30 degrees, 0.8 to 1.4 m long on the ground."""
    return Ramp(float(rng.uniform(10.0, 30.0)), float(rng.uniform(0.8, 1.4)))
