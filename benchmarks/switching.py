"""What a switch of estimators does to the joints: target jumps, torque and slip beside other steps.

Robots walk in MuJoCo under the real controller, without the selector's memory. Their camera goes
black for half a second, at another time for each seed, so that OP takes over and hands back. A step
counts as a switch for `AFTER` steps after it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np
import tyro

from facts import errors_in_one_line, report, spread
from renet.bundle import Bundle
from renet.deploy.cameras.faulty import FaultyCamera
from renet.deploy.cameras.sim import SimCamera
from renet.deploy.controller import Controller
from renet.deploy.loop import run_control_loop
from renet.deploy.robots.sim.mujoco import MujocoRobot
from renet.deploy.robots.sim.scene import build_scene
from renet.deploy.safety.machine import Mode
from renet.deploy.teleop.scripted import ScriptedTeleop
from renet.errors import RenetError
from renet.faults import parse_fault
from renet.interface import LEGS

AFTER = 3
"""Control steps."""


@dataclass(frozen=True)
class Cfg:
    json: Path | None = None
    """File for the results."""
    seconds: float = 20.0
    """Seconds of each run."""
    seeds: int = 4
    terrains: tuple[str, ...] = ("flat", "stairs")


def walk(bundle: Bundle, terrain: str, seconds: float, seed: int) -> list[tuple]:
    """(vision, jump, torque, slip) of each walking step."""
    model, ground = build_scene(terrain, 3, seed=seed)
    robot = MujocoRobot(model, bundle.manifest.robot, ground)
    begins = np.arange(4.0 + np.random.default_rng(seed).random(), seconds, 7.0)
    faults = [parse_fault(f"blackout@{begin:g}s+0.5s") for begin in begins]
    camera = FaultyCamera(SimCamera(robot, bundle.manifest.camera, seed), faults, robot.now, seed)
    controller, rows = Controller(bundle), []
    feet = [model.geom(f"{leg}_foot_collision").id for leg in LEGS]
    before = {"target": None}

    def look(command, state) -> None:
        target, last = command.position, before["target"]
        before["target"] = target
        if controller.decision.mode is not Mode.WALKING or last is None:
            return
        touching = {c.geom1 for c in robot.data.contact} | {c.geom2 for c in robot.data.contact}
        slip = 0.0
        for foot in feet:
            if foot in touching:
                velocity = np.zeros(6)
                kind = mujoco.mjtObj.mjOBJ_GEOM
                mujoco.mj_objectVelocity(model, robot.data, kind, foot, velocity, 0)
                slip = max(slip, float(np.hypot(*velocity[3:5])))
        torque = float(np.abs(robot.read().joint_torque).max())
        jump = float(np.abs(target - last).max())
        rows.append((controller.decision.vision, jump, torque, slip))

    camera.start()
    run_control_loop(
        robot,
        camera,
        ScriptedTeleop(0.6),
        controller,
        done=lambda: robot.now() >= seconds or robot.base_rotation[2, 2] <= 0.5,
        on_step=look,
    )
    return rows


def without_memory(bundle: Bundle) -> Bundle:
    """A bundle whose selector hands over to OP as soon as its filter lets it."""
    selector = replace(bundle.manifest.selector, longest_memory=0.0)
    return replace(bundle, manifest=replace(bundle.manifest, selector=selector))


def main(cfg: Cfg) -> None:
    """Walk, and print and write the results.

    Raises:
        RenetError: There is no seed, no estimator switched, or the file cannot be written.
    """
    if cfg.seeds < 1:
        raise RenetError(f"seeds must be at least 1, got {cfg.seeds}")
    bundle, results = Bundle.load(), {}
    for terrain in cfg.terrains:
        first, after, others = [], [], []
        for seed in range(1, cfg.seeds + 1):
            rows = walk(without_memory(bundle), terrain, cfg.seconds, seed)
            vision = np.array([row[0] for row in rows])
            numbers = np.array([row[1:] for row in rows]).reshape(-1, 3)
            switched = np.flatnonzero(vision[1:] != vision[:-1]) + 1
            near = np.zeros(len(rows), bool)
            for step in switched:
                near[step : step + AFTER] = True
            first.append(numbers[switched])
            after.append(numbers[near])
            others.append(numbers[~near])
        first, after, others = (np.concatenate(part) for part in (first, after, others))
        if not len(first):
            raise RenetError(f"no estimator switched on {terrain}: give more --seconds than 5")
        results[terrain] = {
            "switches": len(first),
            "target_jump_rad": {"switch": spread(first[:, 0]), "others": spread(others[:, 0])},
            "peak_torque_nm": {"switch": spread(after[:, 1]), "others": spread(others[:, 1])},
            "foot_slip_m_s": {"switch": spread(after[:, 2]), "others": spread(others[:, 2])},
        }
    report(results | {"bundle_sha256": bundle.sha256}, cfg.json)


if __name__ == "__main__":
    with errors_in_one_line():
        main(tyro.cli(Cfg))
