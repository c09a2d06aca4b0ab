"""Sensors and motors that freeze, stick, drift or die while a simulated robot walks: who is told?

The controller of `renet deploy` walks a Go1 in MuJoCo with its camera. At a drawn moment one drawn
part fails for good, in a drawn way. A servo acts on its own encoder: one that fails moves the
joint, too. Counted is how soon the controller brakes or warns, and whether the robot, braked or
not, comes to harm in the five seconds after the fault: whether it falls, or turns or runs where
nobody told it to.

With `--minutes` healthy robots are pushed about instead, on all terrains, and every alarm counts.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, get_args

import numpy as np
import tyro

from facts import errors_in_one_line, report
from renet.bundle import Bundle
from renet.deploy.cameras.sim import SimCamera
from renet.deploy.controller import Controller
from renet.deploy.loop import run_control_loop
from renet.deploy.robots.base import JointCommand, RobotState
from renet.deploy.robots.sim.mujoco import MujocoRobot
from renet.deploy.robots.sim.scene import build_scene
from renet.deploy.safety.limits import SafetyCfg
from renet.deploy.safety.machine import ENDED, Mode
from renet.deploy.teleop.base import TeleopCommand
from renet.errors import RenetError
from renet.interface import CONTROL_DT, JOINTS, Terrain, control_steps
from renet.motor_models import IDEAL, find_motors
from renet.robots import find_robot

PARTS = ("encoder", "encoders", "gyroscope", "attitude", "imu", "motor")
KINDS = ("freezes", "sticks", "drifts", "dies")
HARMLESS = 5.0
"""Seconds for which a robot must come to no harm where nobody is told."""
SOON = 0.5
"""Seconds within which an operator is to be told."""
FALLEN = math.cos(math.radians(60.0))
"""Least upright share of the trunk's axis of a robot that has not fallen."""
RUNAWAY = 0.8
"""m/s or rad/s by which a mean over a second may differ from what the robot was told."""
LONGEST = 40.0
"""Seconds of a healthy robot's walk, after which another begins."""
PUSH = 5.0
"""Mean seconds between two pushes of healthy robots."""


@dataclass(frozen=True)
class Cfg:
    json: Path | None = None
    """File for the results."""
    faults: int = 60
    """Faults that are drawn with each seed."""
    minutes: float = 0.0
    """Minutes of healthy walking with each seed instead."""
    bundle: str = "go1-parkour"
    """Name of the bundle."""
    motors: str = IDEAL
    """Motors of healthy robots, as `renet deploy --motors` takes them; others have ideal ones."""
    seeds: tuple[int, ...] = (1,)


@dataclass(frozen=True)
class Fault:
    """One part that fails."""

    part: str
    kind: str
    joint: int
    """Of an encoder or a motor."""
    time: float
    """s on the robot's clock."""
    size: float
    """rad/s, or rad/s²: how fast it drifts."""


class FailingRobot(MujocoRobot):
    """A simulated robot of which one part fails."""

    def __init__(self, fault: Fault | None, seed: int, *arguments, **options) -> None:
        super().__init__(*arguments, **options)
        self.fault, self._random = fault, np.random.default_rng(seed)
        self._true: RobotState | None = None
        self._held: RobotState | None = None
        self._sent: JointCommand | None = None
        self._free_at = 0.0

    def read(self) -> RobotState:
        state = super().read()
        fault = self.fault
        if fault is None or fault.part == "motor" or state.time < fault.time:
            return state
        return self._spoilt(state, fault)

    def _spoilt(self, state: RobotState, fault: Fault) -> RobotState:
        """A reading of which a part is wrong."""
        since, names, rows = state.time - fault.time, _vectors(fault.part), _rows(fault)
        changes = {name: getattr(state, name).copy() for name in names}
        if fault.kind in ("freezes", "sticks"):
            if self._held is None or (fault.kind == "sticks" and state.time >= self._free_at):
                self._held = state
                self._free_at = state.time + self._random.uniform(0.1, 0.4)
            for name in names:
                changes[name][rows] = getattr(self._held, name)[rows]
        elif fault.kind == "dies":
            for name in names:
                changes[name][rows] = [1.0, 0, 0, 0] if name == "quaternion" else 0.0
        else:
            _drift(changes, rows, fault.size, since)
        return replace(state, **changes)

    def write(self, command: JointCommand) -> None:
        self._sent = command
        super().write(command)

    def wait(self, until: float) -> None:
        if self.fault is None or self.now() < self.fault.time:
            super().wait(until)
            return
        # The servos' own encoders fail with those that are read, at every physics step.
        step = self.model.opt.timestep
        for _ in range(round((until - self.now()) / step)):
            self._fail(self.fault)
            super().wait(self.now() + step)

    def _fail(self, fault: Fault) -> None:
        """Let the servos act on what their encoders say, or not at all."""
        sent, data, ids = self._sent, self.data, self._servos.ids
        if sent is None:
            return
        if fault.part == "motor":
            self._fail_motor(fault, sent)
        elif fault.part in ("encoder", "encoders"):
            state, (stiffness, damping) = self.read(), (sent.stiffness, sent.damping)
            torque = stiffness * (sent.position - state.joint_position)
            torque = torque - damping * state.joint_velocity
            self.model.actuator_gainprm[ids, 0] = 1.0
            self.model.actuator_biasprm[ids, 1:3] = 0.0
            data.ctrl[ids] = torque

    def _fail_motor(self, fault: Fault, sent: JointCommand) -> None:
        """Freeze: more friction than torque. Stick: some. Drift: grow weak. Die: no torque."""
        joint, dof = fault.joint, self._velocity[fault.joint]
        if fault.kind == "freezes":
            self.model.dof_frictionloss[dof] = 100.0
        elif fault.kind == "sticks":
            self.model.dof_frictionloss[dof] = 10.0
        else:
            share = 0.0
            if fault.kind == "drifts":
                share = max(1.0 - (self.now() - fault.time) * fault.size, 0.0)
            stiffness, damping = sent.stiffness.copy(), sent.damping.copy()
            stiffness[joint] *= share
            damping[joint] *= share
            super().write(JointCommand(sent.position, stiffness, damping))


def _vectors(part: str) -> tuple[str, ...]:
    """Vectors of a reading that a part makes."""
    return {
        "encoder": ("joint_position", "joint_velocity"),
        "encoders": ("joint_position", "joint_velocity"),
        "gyroscope": ("angular_velocity",),
        "attitude": ("quaternion",),
        "imu": ("quaternion", "angular_velocity"),
    }[part]


def _rows(fault: Fault) -> slice:
    """Numbers of a vector that fail."""
    return slice(fault.joint, fault.joint + 1) if fault.part == "encoder" else slice(None)


def _drift(changes: dict[str, np.ndarray], rows: slice, size: float, since: float) -> None:
    """Let a part of a reading drift away: angles and attitude at a speed, a gyroscope's bias."""
    if "joint_position" in changes:
        changes["joint_position"][rows] += size * since
    elif "quaternion" in changes:
        w, x, y, z = changes["quaternion"]
        half = 0.5 * size * since
        c, s = math.cos(half), math.sin(half)  # About the base's own y axis.
        changes["quaternion"] = np.array(
            [c * w - s * y, c * x - s * z, c * y + s * w, c * z + s * x]
        )
    else:
        changes["angular_velocity"][:] += size * since


def draw(seed: int) -> Fault:
    """A fault by its seed."""
    random = np.random.default_rng([seed, 7])
    part, kind = str(random.choice(PARTS)), str(random.choice(KINDS))
    time, size = random.uniform(2.5, 6.0), random.uniform(0.2, 2.0)
    return Fault(part, kind, int(random.integers(len(JOINTS))), round(time, 2), float(size))


def walk(cfg: Cfg, fault: Fault | None, seed: int, terrain: str, seconds: float) -> dict:
    """Walk a robot and see what becomes of it."""
    bundle, random = Bundle.load(Path(cfg.bundle)), np.random.default_rng(seed)
    spec = bundle.manifest.robot
    level = int(random.integers(1, 8))
    model, ground = build_scene(terrain, level, None, seed, find_robot(spec.name))
    motors = find_motors(cfg.motors, spec.name)
    options = {} if motors is None else {"motors": motors}
    robot = FailingRobot(fault, seed, model, spec, ground, **options)
    events = []
    controller = Controller(bundle, SafetyCfg(stand_up_seconds=0.5), on_event=events.append)
    wait, asked, path = robot.wait, [0.0, 0.0], []

    def pushed(until: float) -> None:
        if fault is None and random.random() < CONTROL_DT / PUSH:
            robot.data.qvel[:2] += 0.5 * random.standard_normal(2)
        wait(until)

    def steer(now: float) -> TeleopCommand:
        if control_steps(now) % 200 == 60:
            asked[0] = float(random.choice((0.3, 0.6, 1.0) if fault else (0.0, 0.3, 0.6, 1.0)))
            asked[1] = 0.0 if fault else float(random.choice((0.0, 0.0, 0.5, -0.8)))
        return TeleopCommand(arm=control_steps(now) == 1, forward=asked[0], turn_rate=asked[1])

    def note(command, state) -> None:
        turn_rate = robot.data.qvel[robot._motion][5]
        rotation = robot.base_rotation
        told = controller.decision.asked
        path.append(
            (
                robot.now(),
                rotation[2, 2],
                robot.data.qvel[:2] @ rotation[:2, 0],
                turn_rate,
                told.forward,
                told.turn_rate,
            )
        )

    def done() -> bool:
        # After a fault the robot is observed on, braked or not; an alarm without one ends a walk.
        alarm = robot.now() > 1.0 and controller.machine.mode is Mode.DAMPING
        braked = fault is None and alarm
        return braked or robot.now() > seconds or robot.base_rotation[2, 2] < FALLEN

    robot.wait = pushed
    camera = SimCamera(robot, bundle.manifest.camera, seed)
    hand = SimpleNamespace(command=steer)
    run_control_loop(robot, camera, hand, controller, on_step=note, done=done)
    # A robot is braked, or its operator is told that a part of it fails.
    alarms = [e for e in events if e.what in (Mode.DAMPING, "robot") and e.why != ENDED]
    return {
        "terrain": terrain,
        "level": level,
        "seconds": round(robot.now(), 2),
        "told": round(alarms[0].time, 2) if alarms else None,
        "why": alarms[0].why if alarms else "",
        "harm": harm(np.array(path), 1.0 if fault is None else fault.time, seconds),
    }


def harm(path: np.ndarray, since: float, until: float) -> float | None:
    """Time at which a walk came to harm, s; None if it did not.

    Harm is a fall, or a second in which the robot ran or turned as nobody told it to.

    Args:
        path: [T, 6] of time, upright share, speed, turn rate, and the speed and turn rate told.
        since: s, from which harm counts.
        until: s, up to which it counts.
    """
    walked = path[(path[:, 0] >= since) & (path[:, 0] <= until)]
    fell = walked[walked[:, 1] < FALLEN, 0]
    window = control_steps(1.0)
    astray = walked[:, 2:4] - walked[:, 4:6]
    runs = np.array([])
    if len(walked) >= window:
        means = np.stack([np.convolve(a, np.ones(window) / window, "valid") for a in astray.T])
        runs = walked[window - 1 :, 0][(np.abs(means) > RUNAWAY).any(axis=0)]
    times = [float(found[0]) for found in (fell, runs) if len(found)]
    return round(min(times), 2) if times else None


def judge(fault: Fault, outcome: dict) -> str:
    """What became of a fault: told soon, told in time, harmless, or harmful.

    A robot that was braked, or told of, before the fault says nothing about it: a false alarm.
    """
    told, harmed = outcome["told"], outcome["harm"]
    if told is not None and told < fault.time:
        return "false alarm"
    if told is not None and told - fault.time <= SOON + 1e-6:
        return "told soon"
    if harmed is None:
        return "told later, no harm" if told is not None else "harmless"
    if told is not None and told < harmed:
        return "told before harm"
    return "harm"


def main(cfg: Cfg) -> None:
    """Run, print and write the results.

    Raises:
        RenetError: An option is of no use, or the file cannot be written.
    """
    # A servo acts on its own encoder here, which other motors would not know.
    if cfg.motors != IDEAL and not cfg.minutes:
        raise RenetError(
            "parts fail on a robot with ideal motors: leave out --motors, or give --minutes"
        )
    run = healthy if cfg.minutes else failing
    sets = [{"seed": seed, **run(cfg, seed)} for seed in cfg.seeds]
    results = {"bundle": cfg.bundle, "motors": cfg.motors, "sets": sets}
    report(results, cfg.json)


def failing(cfg: Cfg, seed: int) -> dict[str, Any]:
    """Walk once with each drawn fault."""
    rows = []
    for number in range(cfg.faults):
        fault = draw(1000 * seed + number)
        outcome = walk(cfg, fault, 1000 * seed + number, "flat", fault.time + HARMLESS)
        verdict = judge(fault, outcome)
        rows.append({**asdict(fault), **outcome, "verdict": verdict})
        print(number, fault.part, fault.kind, verdict, outcome["why"], flush=True)
    verdicts = Counter(row["verdict"] for row in rows)
    strict = verdicts["told soon"] + verdicts["harmless"]
    counts = {
        "faults": cfg.faults,
        "told_soon_or_no_harm": strict + verdicts["told later, no harm"],
        "told_soon_or_never_and_no_harm": strict,
        "verdicts": dict(verdicts),
    }
    print(counts, flush=True)
    return {**counts, "rows": rows}


def healthy(cfg: Cfg, seed: int) -> dict[str, Any]:
    """Walk healthy robots, pushed, over all terrains in turn."""
    terrains, passed, rows = get_args(Terrain), 0.0, []
    while passed < 60.0 * cfg.minutes - 1.0:
        number = len(rows)
        seconds = min(LONGEST, 60.0 * cfg.minutes - passed)
        terrain = terrains[number % len(terrains)]
        rows.append(walk(cfg, None, 1000 * seed + number, terrain, seconds))
        passed += rows[-1]["seconds"]
        print(f"{passed:7.1f} s", rows[-1]["terrain"], rows[-1]["why"], flush=True)
    alarms = Counter(row["why"] for row in rows if row["why"])
    return {"minutes": round(passed / 60.0, 1), "alarms": dict(alarms), "rows": rows}


if __name__ == "__main__":
    with errors_in_one_line():
        main(tyro.cli(Cfg, description=__doc__))
