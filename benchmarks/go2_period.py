"""How evenly the Go2's sender commands its motors: the times between commands, at 500 Hz by design.

A simulated Go2, the controller's process (this one, which commands at 50 Hz) and the sender are
three processes on the loopback interface. A command's time is that at which the sender wrote it.
"""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from facts import errors_in_one_line, report, spread
from renet.deploy.dds.network import Network
from renet.deploy.realtime import realtime
from renet.deploy.robots.base import JointCommand
from renet.deploy.robots.go2.driver import go2_robot
from renet.deploy.robots.go2.link import COMMAND_TOPIC
from renet.deploy.robots.go2.messages import LowCmd
from renet.interface import CONTROL_DT

STANDING = np.tile((0.0, 0.9, -1.8), 4)
RISING = 1.5
"""Seconds from lying to standing."""


@dataclass(frozen=True)
class Cfg:
    json: Path | None = None
    """File for the results."""
    seconds: float = 30.0
    domain: int = 99
    """DDS domain of the trial; robots are in 0."""


def main(cfg: Cfg) -> None:
    simulate = [sys.executable, "-m", "renet", "simulate", f"--domain={cfg.domain}"]
    simulation = subprocess.Popen(simulate, stdout=subprocess.DEVNULL)
    commands = Network("lo", cfg.domain).reader(COMMAND_TOPIC, LowCmd, depth=10_000)
    robot, written, ages = go2_robot("lo", cfg.domain, timeout=30.0), [], []
    try:
        robot.connect()
        with realtime(50) as refused:
            begun = robot.now()
            lying = robot.read().joint_position
            while (passed := robot.now() - begun) < cfg.seconds:
                pose = lying + min(passed / RISING, 1.0) * (STANDING - lying)
                robot.write(JointCommand(pose, np.full(12, 40.0), np.ones(12)))
                ages.append(1000.0 * (robot.now() - robot.read().time))
                written += [sample.sample_info.source_timestamp for sample in commands.take(100)]
                robot.wait(begun + passed + CONTROL_DT)
    finally:
        robot.close()
        simulation.terminate()
        simulation.wait()
    report(
        {
            "period_ms": spread(np.diff(written) / 1e6),
            "state_age_ms": spread(ages),
            "commands": len(written),
            "seconds": cfg.seconds,
            "refused": refused,
            "refused_to_the_sender": robot.refused,
        },
        cfg.json,
    )


if __name__ == "__main__":
    with errors_in_one_line():
        main(tyro.cli(Cfg))
