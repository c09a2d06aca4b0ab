"""What the runtime costs on one CPU thread: steps, the 50 Hz loop's punctuality, memory, bytes.

The real loop, controller, vision thread and recorder run in real time against a robot and a camera
made of random numbers. Nothing here imports torch or MuJoCo. The loop asks for real-time priority,
as on a robot's computer. Every step of walking counts.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
import tyro

from facts import errors_in_one_line, report
from renet.bundle import Bundle
from renet.bundle.manifest import RobotSpec
from renet.bundle.models import MODELS
from renet.deploy.cameras.base import DepthFrame
from renet.deploy.controller import Controller
from renet.deploy.loop import run_control_loop
from renet.deploy.main import PRIORITY
from renet.deploy.realtime import realtime
from renet.deploy.recording.recorder import Recorder
from renet.deploy.robots.base import JointCommand, RobotState
from renet.deploy.safety.limits import SafetyCfg
from renet.deploy.safety.machine import Mode
from renet.deploy.teleop.scripted import ScriptedTeleop
from renet.interface import DEPTH_SHAPE
from renet.pilot import inference
from renet.pilot.tick import EstimatorInput, EstimatorOutput, infer
from renet.robots import GO1

RARELY = SafetyCfg(max_gap=10.0, max_late=1_000_000)
"""A busy machine must not end the measurement: late steps are what it is for."""
LATE_MS = 1000.0 * inference.ThreadedInference.patience
"""From here on a command is late: the loop would not have waited longer for the vision thread."""
WORK = """
import os, sys
os.sched_setaffinity(0, {int(sys.argv[1])})
import numpy
matrix = numpy.random.default_rng(0).standard_normal((1024, 1024), numpy.float32)
while True:
    matrix @ matrix
"""
"""A neighbour: it computes without end on the core that it is given, and fills its caches."""

WITNESS = """
import os, sys, time
os.sched_setaffinity(0, {int(sys.argv[1])})
os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(99))
due = time.monotonic()
while True:
    due += 0.002
    time.sleep(max(0.0, due - time.monotonic()))
    now = time.monotonic()
    if now - due > 0.004:
        print(due, now, flush=True)
        due = now
"""
"""Sleeps with the highest priority there is, and prints when it was woken over 4 ms late: then its
core was with nobody, because a virtual machine's host had it, or with the kernel."""


@dataclass(frozen=True)
class Cfg:
    json: Path | None = None
    """File for the results."""
    bundle: Path | None = None
    ticks: int = 3_000
    """Vision ticks to count; there are ten a second."""
    neighbours: int = 0
    """Processes that keep the cores busy meanwhile, shared among all of them."""


class RandomRobot:
    """Stands and trembles, on the wall clock; notes when wakes and commands come, in ms after the
    control step was due."""

    def __init__(self, robot: RobotSpec) -> None:
        self.description = GO1
        self._pose, self._random = np.array(robot.default_position), np.random.default_rng(0)
        self._due = self.now()
        self.wake_ms = [0.0]
        self.command_ms: list[float] = []
        self.due: list[float] = []

    def now(self) -> float:
        return time.monotonic()

    def wait(self, until: float) -> None:
        self._due = until
        time.sleep(max(0.0, until - self.now()))
        self.wake_ms.append(1000.0 * (self.now() - until))

    def read(self) -> RobotState:
        noise = 0.05 * self._random.standard_normal((3, 12))
        upright = np.array([1.0, 0.0, 0.0, 0.0])
        return RobotState(
            self.now(), self._pose + noise[0], noise[1], noise[2], upright, noise[2, :3]
        )

    def write(self, command: JointCommand) -> None:
        self.command_ms.append(1000.0 * (self.now() - self._due))
        self.due.append(self._due)


class RandomCamera:
    """Ten frames a second of a noisy slope."""

    def __init__(self) -> None:
        random = np.random.default_rng(0)
        slope = np.linspace(0.9, 0.3, DEPTH_SHAPE[0])[:, None]
        noise = 0.01 * random.standard_normal((50, *DEPTH_SHAPE))
        self._images = np.clip(slope + noise, 0.0, 1.0).astype(np.float32)
        self._frame = DepthFrame(self._images[0], -1, 0.0)

    def latest(self) -> DepthFrame:
        number = int(10.0 * time.monotonic())
        if number != self._frame.number:
            self._frame = DepthFrame(self._images[number % 50], number, number / 10.0)
        return self._frame


class Stopwatch:
    """Times `infer` on whatever thread it runs."""

    def __init__(self) -> None:
        self.wall_ms: list[float] = []
        self.cpu_ms: list[float] = []

    def __call__(self, sessions: inference.Sessions, inputs: EstimatorInput) -> EstimatorOutput:
        wall = time.perf_counter()
        cpu = time.thread_time()
        output = infer(sessions, inputs)
        self.wall_ms.append(1000.0 * (time.perf_counter() - wall))
        self.cpu_ms.append(1000.0 * (time.thread_time() - cpu))
        return output


class Step(NamedTuple):
    """What one control step took."""

    walking: bool
    vision: bool
    """A vision tick began in it."""
    blind: bool
    """It began one whose result had not come when the command was due."""
    trusted: bool
    """VP drove."""
    wall_ms: float
    cpu_ms: float
    """Of the loop's thread alone."""


class TimedController(Controller):
    """Times every control step: checks, observation, policy, selector, limits, and the wait for the
    vision thread where a vision tick begins."""

    def __init__(self, *arguments) -> None:
        super().__init__(*arguments)
        self.steps: list[Step] = []

    def tick(self, *arguments) -> JointCommand:
        due = self.policy.due
        wall = time.perf_counter()
        cpu = time.thread_time()
        command = super().tick(*arguments)
        wall_ms = 1000.0 * (time.perf_counter() - wall)
        cpu_ms = 1000.0 * (time.thread_time() - cpu)
        made = self.decision
        walking = made.mode is Mode.WALKING
        vision = walking and due
        blind = vision and (made.fallback or not made.inferred)
        self.steps.append(Step(walking, vision, blind, made.vision, wall_ms, cpu_ms))
        return command


@contextmanager
def neighbours(count: int) -> Iterator[None]:
    """Processes of normal priority that compute without end, in turn on each core."""
    cores = sorted(os.sched_getaffinity(0))
    alone = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    processes = []
    try:
        for number in range(count):
            core = str(cores[number % len(cores)])
            processes.append(subprocess.Popen([sys.executable, "-c", WORK, core], env=alone))
        yield
    finally:
        for process in processes:
            process.kill()
            process.wait()


@contextmanager
def witnesses() -> Iterator[list[tuple[float, float]]]:
    """One on each core; when they stalled is known at the end, in s of the monotonic clock.

    Nothing is known where the system refuses them their priority.
    """
    stalls: list[tuple[float, float]] = []
    command = [sys.executable, "-c", WITNESS]
    processes = [
        subprocess.Popen(
            [*command, str(core)], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
        for core in os.sched_getaffinity(0)
    ]
    try:
        yield stalls
    finally:
        for process in processes:
            process.kill()
            told, _ = process.communicate()
            for line in told.splitlines():
                begin, end = map(float, line.split())
                stalls.append((begin, end))


def spread(values: Sequence[float] | np.ndarray) -> dict[str, float]:
    """Median, 99th and 99.9th percentile, and the largest of all values."""
    names = ("p50", "p99", "p99.9", "max")
    points = np.percentile(values, (50, 99, 99.9, 100))
    return {name: round(float(point), 3) for name, point in zip(names, points, strict=True)}


def walk(bundle: Bundle, ticks: int) -> tuple[RandomRobot, TimedController, str]:
    """Walk for so many vision ticks; returns what was noted, and what the system refused."""
    robot = RandomRobot(bundle.manifest.robot)
    camera = RandomCamera()
    with TemporaryDirectory() as folder:
        recorder = Recorder(Path(folder) / "recording.mcap", {})
        with realtime(PRIORITY) as refused:
            # Inside, as in `renet deploy`: so the vision thread inherits the priority.
            controller = TimedController(bundle, RARELY, inference.ThreadedInference)
            devices: tuple = (robot, camera, ScriptedTeleop(0.6), controller, recorder)
            seen = 0

            def done() -> bool:
                nonlocal seen
                seen += bool(controller.steps) and controller.steps[-1].vision
                return seen >= ticks

            run_control_loop(*devices, done=done)
        controller.close()
        recorder.close()
        if recorder.problem:
            raise SystemExit(recorder.problem)
    return robot, controller, refused


def results(
    robot: RandomRobot, controller: TimedController, stalls: list[tuple[float, float]]
) -> dict[str, Any]:
    """Times of every step of walking, and of those with and without a vision tick."""
    assert len(robot.command_ms) == len(controller.steps)
    walking, vision, blind, trusted, wall, cpu = np.array(controller.steps).T
    walks, sees = walking > 0, vision > 0
    wakes = np.array(robot.wake_ms[: len(walks)])
    commands = np.array(robot.command_ms)
    late = commands > LATE_MS
    late_ticks = sees & (late | (blind > 0))
    due = np.array(robot.due)
    stalled = np.zeros(len(due), bool)
    for begin, end in stalls:
        stalled |= (begin < due + commands / 1000.0) & (due < end)
    return {
        "step_ms": spread(wall[walks]),
        "policy_step_ms": spread(wall[walks & ~sees]),
        "vision_step_ms": spread(wall[sees]),
        "policy_step_cpu_ms": spread(cpu[walks & ~sees]),
        "wake_late_ms": spread(wakes[walks]),
        "command_late_ms": spread(commands[walks]),
        "steps": int(walks.sum()),
        "steps_late_by_8_ms": int(late[walks].sum()),
        "vision_ticks": int(sees.sum()),
        "vision_ticks_late_by_8_ms": int(late_ticks.sum()),
        "of_them_while_the_machine_stalled": int((late_ticks & stalled).sum()),
        "stalls_of_the_machine": len(stalls),
        "steps_while_the_machine_stalled": int((walks & stalled).sum()),
        "vision_share": round(float(trusted[walks].mean()), 4),
    }


def main(cfg: Cfg) -> None:
    bundle = Bundle.load(cfg.bundle)
    stopwatch = Stopwatch()
    inference.infer = stopwatch
    with neighbours(cfg.neighbours), witnesses() as stalls:
        robot, controller, refused = walk(bundle, cfg.ticks)
        load = os.getloadavg()[1]
    assert "torch" not in sys.modules
    report(
        {
            **results(robot, controller, stalls),
            "vision_ms": spread(stopwatch.wall_ms),
            "vision_cpu_ms": spread(stopwatch.cpu_ms),
            "neighbours": cfg.neighbours,
            "load_meanwhile": load,
            "refused": refused,
            "memory_mb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, 1),
            "bundle_bytes": sum((bundle.path / f"{m}.onnx").stat().st_size for m in MODELS),
            "bundle_sha256": bundle.sha256,
        },
        cfg.json,
    )


if __name__ == "__main__":
    with errors_in_one_line():
        main(tyro.cli(Cfg))
