"""`renet simulate`: a simulated Go2 for drivers to find; its options need no DDS."""

import time
from dataclasses import dataclass
from typing import Literal

from renet.deploy.robots.real.braking import PERIOD
from renet.interface import TRUNK, Terrain


@dataclass(frozen=True)
class SimulateCfg:
    """Let a simulated robot live on this computer's loopback interface, for drivers to find."""

    robot: Literal["go2"] = "go2"
    """go2: a Unitree Go2, behind its vendor's DDS topics."""
    terrain: Terrain = "flat"
    """The ground; stairs lead down from a summit, stairs_up out of a pit."""
    level: int = 1
    """Level of the terrain, 1 to 10."""
    domain: int = 0
    """DDS domain; real robots are in 0."""
    seconds: float = float("inf")
    """How long it lives; until Ctrl-C by default."""


def simulate(cfg: SimulateCfg) -> None:
    """Run at the pace of the wall clock; prints at the end what it was told."""
    from renet.deploy.robots.go2.fake import LOOPBACK_CARD, FakeGo2

    robot = FakeGo2(cfg.domain, cfg.terrain, cfg.level)
    print(
        f"a Go2 lies on {cfg.terrain!r}, interface {LOOPBACK_CARD}, domain {cfg.domain}; "
        "Ctrl-C ends"
    )
    begun = time.monotonic()
    try:
        while robot.steps * PERIOD < cfg.seconds:
            robot.step()
            time.sleep(max(0.0, begun + robot.steps * PERIOD - time.monotonic()))
    except KeyboardInterrupt:
        pass
    print(
        f"{robot.steps} steps; commands obeyed {robot.accepted}, with a wrong CRC {robot.wrong}, "
        f"refused in one of its own modes {robot.refused}; trunk at "
        f"{robot.data.body(TRUNK).xpos[2]:.2f} m"
    )
