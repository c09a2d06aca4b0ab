"""Settings of the fault benchmark."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from renet.errors import RenetError
from renet.evaluation.rollout import check_modes, check_speed
from renet.evaluation.switches import check_selector
from renet.evaluation.world import FLAT
from renet.faults import FAULTS, SEVERITIES, fault_class
from renet.faults.physical import Glass
from renet.tasks import RenetEnvCfg
from renet.tasks.config import tile_env_cfg
from renet.tasks.terrains import single_tile_terrain


@dataclass(frozen=True)
class FaultsCfg:
    """Settings of the fault benchmark."""

    out: Path = Path("results/faults")
    """Folder for summary.json, summary.csv, pictures and parts/."""
    bundle: Path | None = None
    """Bundle folder; the one that ships with renet by default."""
    faults: tuple[str, ...] = tuple(FAULTS)
    """Faults to inject."""
    severities: tuple[int, ...] = SEVERITIES
    """Severities, 1 to 5."""
    modes: tuple[str, ...] = ("vp", "renet", "op")
    """Policy modes to compare: vp, renet, op, oracle-switch."""
    robots: int = 20
    """Robots in each setting."""
    quick: bool = False
    """Severities 1, 3, 5 and 10 robots instead."""
    terrain: str = FLAT
    """"flat", or a kind of tile: rough, obstacles, stairs_up, stairs_down, gap, platform."""
    level: int = 3
    """Level of the tile, 1 to 10."""
    speed: float = 0.6
    """Commanded forward speed, m/s."""
    onset: int = 100
    """Control step (0.02 s) at which the fault begins."""
    over: int = 300
    """Control step at which it is over at the latest."""
    steps: int = 400
    """Control steps of each run."""
    healthy_minutes: float = 80.0
    """Robot minutes with a healthy camera, in which false switches are counted; 0: none."""
    selector: str = "monitors"
    """What `renet` trusts: monitors (all of them, dwell) or paper (reconstruction alone)."""
    seed: int = 1
    """Of the robots' starts and of the faults."""
    engine: str = "auto"
    """Physics engine: auto, native or warp."""

    def __post_init__(self) -> None:
        for fault in self.faults:
            for severity in self.severities:
                fault_class(fault).level_of(severity)
        check_modes(self.modes)
        check_speed(self.speed)
        if not (self.faults and self.severities):
            raise RenetError("give at least one fault and one severity")
        if self.robots < 1 or not 0 < self.onset < self.over < self.steps:
            raise RenetError(
                f"robots {self.robots} must be >= 1 and 0 < onset {self.onset} < over {self.over}"
                f" < steps {self.steps}"
            )
        if self.healthy_minutes < 0:
            raise RenetError(f"healthy minutes must be >= 0, got {self.healthy_minutes}")
        check_selector(self.selector)
        self.task(self.terrain)

    def task(self, terrain: str) -> str | RenetEnvCfg:
        """The environment to walk in."""
        if terrain == FLAT:
            return "Renet-Go1-Flat"
        return tile_env_cfg(single_tile_terrain(terrain, self.level), play=True)

    def terrain_of(self, fault: str) -> str:
        """Where a fault is studied: glass needs obstacles that can be glass."""
        fits = fault != Glass.name or self.terrain in Glass.terrains
        return self.terrain if fits else Glass.terrains[0]

    def effective(self) -> tuple[tuple[int, ...], int]:
        """Severities and robots after `quick`."""
        return ((1, 3, 5), 10) if self.quick else (self.severities, self.robots)
