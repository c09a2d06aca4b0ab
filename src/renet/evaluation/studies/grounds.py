"""Grounds of studies: edges of tiles, starts in front of them, and a base of studies by ground."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, ClassVar

from renet.errors import RenetError
from renet.evaluation.study import Part, WalkingStudy
from renet.terrain.tiles import LEVELS, Tile, tiles

if TYPE_CHECKING:
    from renet.evaluation.evaluator import Evaluator
    from renet.tasks import RenetEnvCfg

EDGES = {"gap": 1.2, "platform": 1.4, "stairs_up": 1.2, "stairs_down": 1.5}
"""Distance from the middle of a tile, where robots start, to the first edge, m, by kind."""
NEAREST = min(EDGES.values())
"""Shortest of these distances, m."""
_START_YAW = 0.1
"""Largest angle between a robot's start and the yaw that it is to have, rad."""


def onset_before_edge(speed: float, lead: float = 0.5, edge: float = NEAREST) -> float:
    """Return the time at which a robot is `lead` seconds before an edge, s; at least 0.

    Args:
        speed: Commanded speed, m/s.
        lead: Time before the edge, s.
        edge: Distance from the start to the edge, m; by default to the nearest of all kinds.
    """
    return max(edge / speed - lead, 0.0)


def start_facing(cfg: RenetEnvCfg, yaw: float = 0.0) -> None:
    """Let robots start at a yaw, give or take 0.1 rad, in place.

    Args:
        cfg: Task whose obstacle is straight ahead, along +x.
        yaw: Yaw of the start, rad; 0: robots walk straight at the obstacle.
    """
    yaws = (yaw - _START_YAW, yaw + _START_YAW)
    cfg.events["spawn"].params["pose_range"]["yaw"] = yaws


def one_tile_cfg(evaluator: Evaluator, kind: str, tile: Tile) -> RenetEnvCfg:
    """Make a task on a single tile of a kind, in the evaluator's conditions."""
    # It loads PyTorch and mjlab, which take seconds.
    from renet.tasks.terrains import EVALUATION_SEED, parkour_terrain

    return evaluator.terrain_env_cfg(parkour_terrain(EVALUATION_SEED, {kind: tile}, levels=1))


@dataclass(frozen=True)
class LevelStudy(WalkingStudy):
    """Base of studies in which robots have one try on each of some grounds with their levels."""

    seconds: float = 12.0
    """Time to leave the tile, s."""
    grounds: tuple[str, ...] = ()
    """Ground and level, KIND:LEVEL, such as gap:3; levels are 1 to 10."""

    selectable: ClassVar[tuple[str, ...]] = ("grounds",)
    kinds: ClassVar[tuple[str, ...]] = tuple(tiles())
    """Kinds of ground that the study can walk on."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.grounds:
            raise RenetError("give a ground")
        for ground in self.grounds:
            kind, _, level = ground.partition(":")
            if kind not in self.kinds or not level.isdecimal() or not 1 <= int(level) <= LEVELS:
                raise RenetError(
                    f"ground {ground!r}: write KIND:LEVEL, of {', '.join(self.kinds)} and 1 to"
                    f" {LEVELS}, such as gap:3"
                )

    def parts(self, evaluator: Evaluator) -> Mapping[str, Callable[[], Part]]:
        """Return one part for each ground."""
        parts = {}
        for number, ground in enumerate(self.grounds, start=1):
            kind, level = ground.split(":")
            title = f"{number}/{len(self.grounds)} {ground}"
            walk = partial(self.walk_on, evaluator, kind, int(level), title)
            # The name is part of a file name, which has no colon on some systems.
            parts[ground.replace(":", "_")] = walk
        return parts

    def walk_on(self, evaluator: Evaluator, kind: str, level: int, title: str) -> Part:
        """Walk on one ground and return its part, with a title for the progress."""
        raise NotImplementedError

    def by_ground(self, parts: Mapping[str, Part]) -> dict[str, Part]:
        """Return the part of each ground, by the ground as it is written in the settings."""
        return {ground: parts[ground.replace(":", "_")] for ground in self.grounds}
