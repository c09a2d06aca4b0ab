"""The course: passages in a row, each as wide as its tile, so that nothing can be walked around.

Tiles of 8 m lie along +y, from one flat edge to the next. Grass and an occlusion are faults of the
camera for as long as the robot is on that tile. Obstacles are as large as the curriculum's.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

import mujoco
import numpy as np
import torch
from mjlab.managers.termination_manager import TerminationTermCfg
from mjlab.terrains import TerrainEntityCfg, TerrainGeneratorCfg
from torch import Tensor

from renet.errors import RenetError
from renet.tasks import RenetEnvCfg, RobotCfg
from renet.tasks.mdp.terminations import PIT_DEPTH
from renet.tasks.parkour_env_cfg import tile_env_cfg
from renet.terrain.tiles import (
    ACCENT,
    FLOOR,
    LEVELS,
    PIT,
    STEEL,
    STONE,
    TILE,
    Obstacles,
    Rough,
    Tile,
    TileBuilder,
    TileGeom,
    tiles,
)

if TYPE_CHECKING:
    from mjlab.envs import ManagerBasedRlEnv

LAP = (
    "flat",
    "grass",
    "grass",
    "stairs",
    "slope",
    "occlusion",
    "rough",
    "platform",
    "gap",
    "stairs",
    "obstacles",
    "grass",
    "flat",
)
"""One lap, in the order of the paper's walk: grass, stairs, slope, platforms and gaps, back."""
SHORT_LAP = ("flat", "grass", "stairs", "slope", "occlusion", "platform", "gap", "flat")
HALF = TILE / 2
SET_DOWN = 0.6
"""Where a robot is set down, m from a tile's beginning; obstacles begin 0.8 m from it or more."""
AHEAD = math.pi / 2
"""World yaw of the course, rad."""
SLOPES = (0.2, 1.0)
"""Rise of a slope over 2 m at the first and last level, m: 6 to 27 degrees."""


@dataclass
class Passage(Tile):
    """A tile that is crossed along y; robots are set down at its beginning."""

    def start(self, height: float) -> np.ndarray:
        """At the tile's beginning."""
        return np.array([HALF, SET_DOWN, height])

    def build(self, builder: TileBuilder, measure: float, rng: np.random.Generator) -> float:
        """Flat ground; see `Tile.build`."""
        builder.square(HALF, FLOOR)
        return 0.0


class Stairs(Passage):
    """Six steps of rise `measure` up, a landing, six down."""

    def build(self, builder: TileBuilder, measure: float, rng: np.random.Generator) -> float:
        """Build the obstacle of size `measure`; returns the height of the origin, m."""
        builder.square(HALF, FLOOR)
        for step in range(1, 7):
            far = 2.6 - (step - 1) * 0.3
            color = STONE if step % 2 else STEEL
            builder.box((-HALF, HALF), (-far, far), (0.0, step * measure), color)
        return 0.0


class Slope(Passage):
    """A ramp that rises by `measure` over 2 m, a landing of 1.2 m, a ramp down."""

    def build(self, builder: TileBuilder, measure: float, rng: np.random.Generator) -> float:
        """Build the obstacle of size `measure`; returns the height of the origin, m."""
        run, landing, thick = 2.0, 0.6, 0.2
        builder.square(HALF, FLOOR)
        builder.box((-HALF, HALF), (-landing, landing), (0.0, measure), STEEL)
        angle, length = math.atan2(measure, run), math.hypot(measure, run)
        for side in (-1.0, 1.0):
            tilt = -side * angle
            # The middle of the ramp's upper face, less half the slab's thickness along its normal.
            y = side * (landing + run / 2) + thick / 2 * math.sin(tilt)
            z = measure / 2 - thick / 2 * math.cos(tilt)
            geom = builder.body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_BOX,
                size=(HALF, length / 2, thick / 2),
                pos=(HALF, HALF + y, z),
                quat=(math.cos(tilt / 2), math.sin(tilt / 2), 0.0, 0.0),
                rgba=STONE,
            )
            builder.geometries.append(TileGeom(geom, STONE))
        return 0.0


class Platforms(Passage):
    """Two platforms `measure` high and 1.5 m long."""

    def build(self, builder: TileBuilder, measure: float, rng: np.random.Generator) -> float:
        """Build the obstacle of size `measure`; returns the height of the origin, m."""
        builder.square(HALF, FLOOR)
        for start in (-2.2, 0.9):
            builder.box((-HALF, HALF), (start, start + 1.5), (-0.1, measure), ACCENT)
        return 0.0


class Gaps(Passage):
    """Two gaps `measure` wide and 1 m deep, 2 m of ground between them."""

    def build(self, builder: TileBuilder, measure: float, rng: np.random.Generator) -> float:
        """Build the obstacle of size `measure`; returns the height of the origin, m."""
        builder.square(HALF, (-1.2, -1.0), PIT)
        start = -1.0 - measure
        stretches = ((-HALF, start), (-1.0, 1.0), (1.0 + measure, HALF))
        for stretch in stretches:
            builder.box((-HALF, HALF), stretch, (-1.0, 0.0))
        return 0.0


class Blocks(Obstacles, Passage):
    """Scattered blocks, as in training."""

    def place(self, a: float, b: float, rng: np.random.Generator) -> tuple[float, float]:
        """Middle of a block of half-sizes a, b that leaves both ends of the tile free, m."""
        x, y = rng.uniform(-3.0, 3.0), rng.uniform(-2.0, 2.5)
        return float(x), float(y)


class Relief(Rough, Passage):
    """Random relief, as in training."""


FAULTS_HERE = {"grass": "grass", "occlusion": "occlusion"}
"""Passages on which the camera fails, and the fault of the catalogue."""


def passage(kind: str, level: int) -> Tile:
    """A passage with obstacles of a level between 1 and 10.

    Raises:
        RenetError: unknown kind or level.
    """
    if not 1 <= level <= LEVELS:
        raise RenetError(f"level must be 1 to {LEVELS}, got {level}")
    share = (level - 1) / (LEVELS - 1)
    known = tiles()
    classes: dict[str, tuple[type[Tile], float]] = {
        "flat": (Passage, 0.0),
        "occlusion": (Passage, 0.0),
        # Level 1 of rough ground is flat: grass grows on what level 4 has.
        "grass": (Relief, known["rough"].measure(max(share, 1 / 3))),
        "rough": (Relief, known["rough"].measure(max(share, 1 / 3))),
        "stairs": (Stairs, known["stairs_up"].measure(share)),
        "slope": (Slope, SLOPES[0] + share * (SLOPES[1] - SLOPES[0])),
        "platform": (Platforms, known["platform"].measure(share)),
        "gap": (Gaps, known["gap"].measure(share)),
        "obstacles": (Blocks, known["obstacles"].measure(share)),
    }
    if kind not in classes:
        raise RenetError(f"unknown passage '{kind}': choose among {', '.join(classes)}")
    build, measure = classes[kind]
    return build(low=measure, high=measure)


def course_env_cfg(
    lap: Sequence[str], levels: Sequence[int], stuck_after: float, seed: int, robot: RobotCfg
) -> RenetEnvCfg:
    """A lap as an environment.

    Args:
        lap: kinds of passage, in order.
        levels: of each passage, 1 to 10.
        stuck_after: seconds on one passage after which a robot counts as stuck.
        seed: of relief and blocks.
        robot: to walk it.

    Raises:
        RenetError: unknown kind or level.
    """
    passages = {f"{i}_{kind}": passage(kind, levels[i]) for i, kind in enumerate(lap)}
    generator = TerrainGeneratorCfg(
        seed=seed,
        curriculum=True,
        size=(TILE, TILE),
        border_width=TILE,
        num_rows=1,
        num_cols=len(lap),
        color_scheme="none",
        sub_terrains=cast(Any, passages),
        add_lights=True,
    )
    terrain = TerrainEntityCfg(terrain_type="generator", terrain_generator=generator)
    cfg = tile_env_cfg(terrain, play=True, robot=robot)
    cfg.terminations["in_gap"] = TerminationTermCfg(func=in_pit)
    cfg.terminations["left_tile"] = TerminationTermCfg(
        func=arrived, params={"length": len(lap) * TILE}, time_out=True
    )
    cfg.terminations["stuck"] = TerminationTermCfg(
        func=Stuck, params={"seconds": stuck_after, "length": len(lap) * TILE}, time_out=True
    )
    around = cfg.events["spawn"].params["pose_range"]
    around["x"], around["y"], around["yaw"] = (-0.3, 0.3), (-0.2, 0.2), (AHEAD - 0.1, AHEAD + 0.1)
    return cfg


def along(env: ManagerBasedRlEnv, length: float) -> Tensor:
    """Metres from the beginning of a course of `length`, [N]; the course is centred."""
    return env.scene["robot"].data.root_link_pos_w[:, 1] + length / 2


def in_pit(env: ManagerBasedRlEnv) -> Tensor:
    """Base below the ground: in a gap."""
    return env.scene["robot"].data.root_link_pos_w[:, 2] < -PIT_DEPTH


def arrived(env: ManagerBasedRlEnv, length: float) -> Tensor:
    """At the end of the course."""
    return along(env, length) > length


class Stuck:
    """Too long on one passage."""

    def __init__(self, cfg: TerminationTermCfg, env: ManagerBasedRlEnv) -> None:
        self._farthest = torch.full((env.num_envs,), -1, device=env.device)
        self._seconds = torch.zeros(env.num_envs, device=env.device)

    def __call__(self, env: ManagerBasedRlEnv, seconds: float, length: float) -> Tensor:
        """[N] bool; call once per control step."""
        now = (along(env, length) / TILE).floor().long()
        self._seconds += env.step_dt
        self._seconds[now > self._farthest] = 0.0
        self._farthest = torch.maximum(self._farthest, now)
        return self._seconds > seconds

    def reset(self, env_ids: Tensor | slice | None = None) -> None:
        """A robot that is set down has all its time."""
        self._farthest[slice(None) if env_ids is None else env_ids] = -1
