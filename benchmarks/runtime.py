"""What the runtime costs on one CPU thread: ticks, the 50 Hz loop's punctuality, memory, bytes.

The real loop, controller and vision thread run in real time against a robot and a camera made of
random numbers. Nothing here imports torch or MuJoCo. The loop asks for real-time priority, as on a
robot's computer.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from facts import report, spread
from renet.bundle import Bundle
from renet.bundle.manifest import RobotSpec
from renet.bundle.models import MODELS
from renet.bundle.policy import EstimatorInput, EstimatorOutput, infer
from renet.deploy import inference
from renet.deploy.cameras.base import DepthFrame
from renet.deploy.controller import Controller
from renet.deploy.loop import run_control_loop
from renet.deploy.realtime import realtime
from renet.deploy.robots.base import JointCommand, RobotState
from renet.deploy.robots.envelope import read_envelope
from renet.deploy.safety.limits import SafetyCfg
from renet.deploy.safety.machine import Mode
from renet.deploy.teleop import ScriptedTeleop
from renet.descriptions import GO1
from renet.interface import CONTROL_DT, DEPTH_SHAPE

WARM_UP = 3.0
"""Seconds of rising and first ticks that do not count."""
RARELY = SafetyCfg(max_gap=10.0, max_late=1_000_000)
"""A busy machine must not end the measurement: late ticks are what it is for."""


@dataclass(frozen=True)
class Cfg:
    json: Path | None = None
    """File for the results."""
    bundle: Path | None = None
    minutes: float = 5.0
    neighbour: bool = False
    """Keep another core busy with a process of its own meanwhile."""


class RandomRobot:
    """Stands and trembles, on the wall clock; notes how late every control step begins."""

    def __init__(self, robot: RobotSpec) -> None:
        self.envelope = read_envelope(GO1)
        self._pose, self._random = np.array(robot.default_position), np.random.default_rng(0)
        self.late_ms: list[float] = []

    def now(self) -> float:
        return time.monotonic()

    def wait(self, until: float) -> None:
        time.sleep(max(0.0, until - self.now()))
        self.late_ms.append(1000.0 * (self.now() - until))

    def read(self) -> RobotState:
        noise = 0.05 * self._random.standard_normal((3, 12))
        upright = np.array([1.0, 0.0, 0.0, 0.0])
        return RobotState(
            self.now(), self._pose + noise[0], noise[1], noise[2], upright, noise[2, :3]
        )

    def write(self, command: JointCommand) -> None:
        pass


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
        wall, cpu = time.perf_counter(), time.thread_time()
        output = infer(sessions, inputs)
        self.wall_ms.append(1000.0 * (time.perf_counter() - wall))
        self.cpu_ms.append(1000.0 * (time.thread_time() - cpu))
        return output


class TimedController(Controller):
    """Times control ticks between vision ticks: observation, policy, selector, limits."""

    def __init__(self, *arguments) -> None:
        super().__init__(*arguments)
        self.wall_ms: list[float] = []
        self.cpu_ms: list[float] = []
        self.trusted: list[bool] = []

    def tick(self, *arguments) -> JointCommand:
        vision = self.policy.due
        wall, cpu = time.perf_counter(), time.thread_time()
        command = super().tick(*arguments)
        if not vision and self.decision.mode is Mode.WALKING:
            self.wall_ms.append(1000.0 * (time.perf_counter() - wall))
            self.cpu_ms.append(1000.0 * (time.thread_time() - cpu))
            self.trusted.append(self.decision.vision)
        return command


@contextmanager
def neighbour(busy: bool) -> Iterator[None]:
    """A process that computes without end on the last core, at normal priority."""
    if not busy:
        yield
        return
    last = max(os.sched_getaffinity(0))
    work = f"import os; os.sched_setaffinity(0, {{{last}}})\nwhile True: sum(range(100000))"
    process = subprocess.Popen([sys.executable, "-c", work])
    try:
        yield
    finally:
        process.kill()
        process.wait()


def main(cfg: Cfg) -> None:
    bundle = Bundle.load(cfg.bundle)
    stopwatch = Stopwatch()
    inference.infer = stopwatch
    robot, camera = RandomRobot(bundle.manifest.robot), RandomCamera()
    controller = TimedController(bundle, RARELY, inference.ThreadedInference)
    end = time.monotonic() + WARM_UP + 60.0 * cfg.minutes
    devices: tuple = (robot, camera, ScriptedTeleop(0.6), controller)
    with neighbour(cfg.neighbour), realtime(50) as refused:
        run_control_loop(*devices, done=lambda: time.monotonic() >= end)
    controller.close()
    assert "torch" not in sys.modules
    steps = round(WARM_UP / CONTROL_DT)
    late = np.array(robot.late_ms[steps:])
    report(
        {
            "policy_ms": spread(controller.wall_ms[40:]),
            "vision_ms": spread(stopwatch.wall_ms[10:]),
            "policy_cpu_ms": spread(controller.cpu_ms[40:]),
            "vision_cpu_ms": spread(stopwatch.cpu_ms[10:]),
            "loop_late_ms": spread(robot.late_ms[steps:]),
            "loop_steps": len(late),
            "loop_steps_late_by_half_a_period": int((late > 500.0 * CONTROL_DT).sum()),
            "minutes": cfg.minutes,
            "neighbour": cfg.neighbour,
            "refused": refused,
            "vision_share": round(float(np.mean(controller.trusted)), 4),
            "memory_mb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, 1),
            "bundle_bytes": sum((bundle.path / f"{m}.onnx").stat().st_size for m in MODELS),
            "bundle_sha256": bundle.sha256,
        },
        cfg.json,
    )


if __name__ == "__main__":
    main(tyro.cli(Cfg))
