"""What every policy meets: 200 episodes, each drawn from the seed of the version and its number.

An episode is a course of two or three obstacles, what the robot is told on the way, and a fault of
its camera. It depends on nothing else: neither on other episodes nor on the policy.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from renet.evaluation.benchmark.families import (
    GLASS,
    LIES,
    LOUD,
    SEVERITIES,
    Families,
    SealedFaults,
    draw_fault,
    fault_of,
    level_at,
)
from renet.faults.base import FOREVER
from renet.terrain.course import Blocks, Course, Gap, Obstacle, Platform, Ramp, Stairs

SEED = 3
"""Of version 3. Results of another seed are no results of the benchmark."""
EPISODES = 200
QUICK_EPISODES = 20
SEALED_EPISODES = 40
"""Further episodes, whose faults are sealed; they are numbered after the others."""
BLOCK = 10
"""Episodes that are walked side by side: bodies are drawn for a block at once."""

STRANGERS = 5
"""Every fifth episode is walked by a stranger."""
RUN_UP = (2.0, 2.8)
"""Ground before the first obstacle, m: no obstacle is in sight at the start."""
SPACE = (0.5, 1.5)
"""Ground between two obstacles, m."""
SPEED = (0.3, 1.0)
"""Commanded, m/s."""
ASKEW = np.radians(30.0)
"""Largest angle between what a robot is told and the course, rad."""
STOP = (1.0, 2.0)
"""Seconds for which a robot is told to stand."""
SIGHT = 1.6
"""m before an edge at which it comes into sight."""
LASTS = (0.5, 8.0)
"""Seconds a fault lasts, log-uniform, unless it lasts to the end, as every second one does."""


@dataclass(frozen=True)
class Episode:
    """One course, its commands and its fault."""

    number: int
    """From 0."""
    obstacles: tuple[Obstacle, ...]
    spaces: tuple[float, ...]
    """Ground before each obstacle, m."""
    speed: float
    """Commanded, m/s."""
    headings: tuple[float, float]
    """Commanded before and after the turn, rad from straight along the course."""
    turn_at: float
    """Position at which the second heading is commanded, m."""
    stop_at: float
    """Position at which the robot is told to stand, m."""
    stop_seconds: float
    family: str
    """Of the fault."""
    lie: bool
    """Whether the fault leaves images that look healthy."""
    fault: str
    """Its name."""
    level: float
    """Its strength, in its own unit."""
    onset: float
    """Position at which the camera begins to fail, m."""
    duration: float
    """Seconds for which it fails."""
    stranger: bool
    """Whether a robot walks that nobody trained on (`stranger.py`)."""

    @property
    def course(self) -> Course:
        """The tile to walk."""
        return Course(obstacles=self.obstacles, spaces=self.spaces, seed=self.number)

    @property
    def name(self) -> str:
        """Of its tile."""
        return f"episode_{self.number}"

    @property
    def seconds(self) -> float:
        """Time for the course: that of half the commanded speed, and for the stop."""
        way = sum(self.spaces) + sum(obstacle.extent for obstacle in self.obstacles)
        return 2.0 * (way + 1.0) / self.speed + self.stop_seconds + 3.0

    def record(self) -> dict[str, Any]:
        """All of it, for JSON."""
        return vars(self) | {"obstacles": [obstacle.record() for obstacle in self.obstacles]}


def draw_episodes(
    numbers: range, seed: int = SEED, sealed: SealedFaults | None = None
) -> list[Episode]:
    """Draw the episodes of some numbers.

    Args:
        numbers: of the episodes; those from `EPISODES` on have sealed faults, which are given.
        seed: of the draw. sealed: the sealed families.
    """
    return [draw_episode(number, seed, sealed) for number in numbers]


def draw_episode(number: int, seed: int = SEED, sealed: SealedFaults | None = None) -> Episode:
    """Draw one episode; see `draw_episodes`."""
    rng = np.random.default_rng([seed, number])
    families, lie = _families(number, sealed)
    family, fault = draw_fault(rng, families)
    level = level_at(fault_of(fault, sealed), int(rng.choice(SEVERITIES)))
    count = int(rng.integers(2, 4))
    obstacles = [draw_obstacle(rng) for _ in range(count)]
    spaces = [float(rng.uniform(*RUN_UP)), *rng.uniform(*SPACE, count - 1).tolist()]
    failing = draw_failing(rng, obstacles)
    if family == GLASS and isinstance(obstacles[failing], Gap):
        # A gap holds nothing that could be of glass.
        obstacles[failing] = draw_platform(rng)
    course = Course(obstacles=tuple(obstacles), spaces=tuple(spaces))
    starts, ends = course.edges.T
    middles = np.concatenate(([0.6], (ends[:-1] + starts[1:]) / 2))
    first = float(rng.uniform(-ASKEW, ASKEW))
    # Back across the middle, so that a turn is worth the name.
    second = float(-np.sign(first) * rng.uniform(0.0, ASKEW))
    onset = float(rng.uniform(starts[failing] - SIGHT, starts[failing]))
    return Episode(
        number=number,
        obstacles=tuple(obstacles),
        spaces=tuple(spaces),
        speed=float(rng.uniform(*SPEED)),
        headings=(first, second),
        turn_at=float(rng.choice(middles)),
        stop_at=float(rng.choice(middles)),
        stop_seconds=float(rng.uniform(*STOP)),
        family=family,
        lie=lie,
        fault=fault,
        level=level,
        onset=onset,
        duration=draw_duration(rng),
        stranger=number % STRANGERS == STRANGERS - 1,
    )


def _families(number: int, sealed: SealedFaults | None) -> tuple[Families, bool]:
    """The families that an episode draws from, and whether they are lies: every second one's."""
    if number >= EPISODES:
        if sealed is None:
            raise ValueError(f"episode {number} needs the sealed families")
        return sealed.families, True
    lie = number % 2 == 1
    return (LIES if lie else LOUD), lie


def draw_failing(rng: np.random.Generator, obstacles: list[Obstacle]) -> int:
    """Draw the obstacle before which the camera fails: one that needs it, if there is any."""
    unseen = [i for i, obstacle in enumerate(obstacles) if isinstance(obstacle, (Gap, Platform))]
    return int(rng.choice(unseen or range(len(obstacles))))


def draw_duration(rng: np.random.Generator) -> float:
    """Draw the seconds for which a camera fails."""
    seconds = float(np.exp(rng.uniform(*np.log(LASTS))))
    return FOREVER if rng.random() < 0.5 else seconds


def draw_obstacle(rng: np.random.Generator) -> Obstacle:
    """Draw an obstacle: its kind, then its sizes uniformly.

    Half of all are gaps and platforms, which cannot be crossed unseen; many of the others can.
    """
    unseen = (draw_stairs, draw_stairs_down, draw_blocks, draw_ramp)
    draws = (draw_gap, draw_platform) if rng.random() < 0.5 else unseen
    return draws[rng.integers(len(draws))](rng)


def draw_gap(rng: np.random.Generator) -> Gap:
    """A gap of 0.3 to 0.9 m."""
    return Gap(float(rng.uniform(0.3, 0.9)))


def draw_platform(rng: np.random.Generator) -> Platform:
    """A platform of 0.2 to 0.6 m, 0.8 to 1.6 m long."""
    return Platform(float(rng.uniform(0.2, 0.6)), float(rng.uniform(0.8, 1.6)))


def draw_stairs(rng: np.random.Generator, sign: int = 1) -> Stairs:
    """Three to six steps of 8 to 24 cm, whose treads are 25 to 40 cm deep."""
    rise, tread = rng.uniform(0.08, 0.24), rng.uniform(0.25, 0.40)
    return Stairs(sign * float(rise), float(tread), int(rng.integers(3, 7)))


def draw_stairs_down(rng: np.random.Generator) -> Stairs:
    """The same, down."""
    return draw_stairs(rng, -1)


def draw_blocks(rng: np.random.Generator) -> Blocks:
    """Blocks of up to 10 to 25 cm on 1.2 to 2 m."""
    return Blocks(float(rng.uniform(0.10, 0.25)), float(rng.uniform(1.2, 2.0)))


def draw_ramp(rng: np.random.Generator) -> Ramp:
    """Ramps of 10 to 30 degrees, 0.8 to 1.4 m long on the ground."""
    return Ramp(float(rng.uniform(10.0, 30.0)), float(rng.uniform(0.8, 1.4)))
