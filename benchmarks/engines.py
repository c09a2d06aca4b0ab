"""The same bundle in two physics engines: who walks, how fast, and who survives a blackout.

Every run has a speed and a seed of its own (camera noise, random parts of the tile). `blind` walks
without a camera, `camera` trusts its own whatever it shows, `memory` is the default.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean

import numpy as np
import tyro

sys.path.append(str(Path(__file__).parents[1] / "examples"))

from facts import errors_in_one_line, report
from pybullet_driver import BulletRobot
from renet.bundle import Bundle
from renet.deploy.cameras.faulty import FaultyCamera
from renet.deploy.cameras.sim import SimCamera
from renet.deploy.controller import Controller
from renet.deploy.loop import run_control_loop
from renet.deploy.robots.sim.mujoco import MujocoRobot
from renet.deploy.robots.sim.scene import build_scene
from renet.deploy.safety.limits import SafetyCfg
from renet.deploy.safety.machine import Mode
from renet.deploy.teleop.scripted import ScriptedTeleop
from renet.faults import parse_fault
from renet.interface import CONTROL_DT

ENGINES = {"mujoco": MujocoRobot, "pybullet": BulletRobot}
SPEEDS = (0.3, 0.9)
"""m/s asked of the first and of the last run."""
STAND_UP = SafetyCfg().stand_up_seconds


@dataclass(frozen=True)
class Cfg:
    json: Path | None = None
    """File for the results."""
    bundle: Path | None = None
    runs: int = 20
    seconds: float = 15.0
    """Seconds of walking."""
    level: int = 3
    engines: tuple[str, ...] = ("mujoco", "pybullet")
    terrains: tuple[str, ...] = ("flat", "stairs", "obstacles")
    cases: tuple[str, ...] = ("blind", "memory", "memory blackout", "camera blackout")
    blackout: float = 5.0
    """Seconds of walking after which the image is black to the end."""


def walk(cfg: Cfg, bundle: Bundle, engine: str, terrain: str, case: str, run: int) -> dict:
    """Seconds walked, metres, m/s forward while walking, seconds from blackout to OP."""
    mode, *fault = case.split()
    model, ground = build_scene(terrain, cfg.level, seed=run)
    robot = ENGINES[engine](model, bundle.manifest.robot, ground)
    camera = None if mode == "blind" else SimCamera(robot, bundle.manifest.camera, seed=run)
    onset = STAND_UP + cfg.blackout
    if camera is not None and fault:
        fault = [parse_fault(f"{fault[0]}@{onset:g}s")]
        camera = FaultyCamera(camera, fault, robot.now, seed=run)
    controller = Controller(bundle, mode=mode)
    speed = float(np.linspace(*SPEEDS, cfg.runs)[run])
    path, delays = [], []

    def look(command, state) -> None:
        if controller.decision.mode is Mode.WALKING:
            path.append(robot.base_position)
            if not (controller.decision.vision or delays or robot.now() < onset):
                delays.append(robot.now() - onset)

    if camera is not None:
        camera.start()
    robot.connect()
    end = STAND_UP + cfg.seconds + 5 * CONTROL_DT
    tripped = lambda: controller.decision.mode is Mode.DAMPING and robot.now() > 1.0  # noqa: E731
    teleop = ScriptedTeleop(speed)
    run_control_loop(
        robot, camera, teleop, controller, on_step=look, done=lambda: robot.now() > end or tripped()
    )
    robot.close()
    seconds = len(path) * CONTROL_DT
    metres = float(np.hypot(*(path[-1] - path[0])[:2])) if path else 0.0
    return {
        "walked": seconds >= cfg.seconds,
        "asked_m_s": round(speed, 3),
        "m_s": round(metres / max(seconds, CONTROL_DT), 3),
        "height_m": round(float(np.median([p[2] for p in path]) - ground), 3) if path else None,
        "delay_s": round(delays[0], 3) if delays and fault else None,
        "why": "" if seconds >= cfg.seconds else controller.machine.reason,
    }


def main(cfg: Cfg) -> None:
    bundle, rows = Bundle.load(cfg.bundle), []
    print("| ground | case | engine | walked | m/s of those asked | s to OP |")
    print("|---|---|---|---|---|---|")
    for terrain in cfg.terrains:
        for case in cfg.cases:
            for engine in cfg.engines:
                begun = time.monotonic()
                runs = [walk(cfg, bundle, engine, terrain, case, n) for n in range(cfg.runs)]
                rows.append({"terrain": terrain, "case": case, "engine": engine, "runs": runs})
                delays = [r["delay_s"] for r in runs if r["delay_s"] is not None]
                print(
                    f"| {terrain} | {case} | {engine} | {sum(r['walked'] for r in runs)} of"
                    f" {len(runs)} | {fmean(r['m_s'] for r in runs):.2f} of"
                    f" {fmean(r['asked_m_s'] for r in runs):.2f} | "
                    + (f"{max(delays):.2f} |" if delays else "- |"),
                    flush=True,
                )
                seconds = round((time.monotonic() - begun) / cfg.runs, 1)
                rows[-1]["wall_s_each"] = seconds
    report({"rows": rows, "bundle_sha256": bundle.sha256}, cfg.json)


if __name__ == "__main__":
    with errors_in_one_line():
        main(tyro.cli(Cfg))
