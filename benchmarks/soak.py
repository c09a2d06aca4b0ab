"""An hour of the runtime in simulation, with everything at random that may go wrong.

Loop, controller, selector, vision, safety machine and recorder of `renet deploy` walk the Go1 in
MuJoCo across a tile, on the simulated clock. Faults of the catalogue come and go, the trunk is
pushed, readings, images and control steps are lost or late, drivers fail. An operator steers, and
puts the robot back on its feet when it was damped.

With `--wall` the hour is one of the wall clock, and inference runs on a thread of its own, as on a
robot. Once a minute another `renet deploy` is killed, interrupted, or meets a full disk; all of
them write to one folder.
"""

from __future__ import annotations

import ctypes
import json
import math
import mmap
import os
import re
import tempfile
import time
from array import array
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro

from facts import report
from flights import Flights
from renet.bundle import Bundle
from renet.deploy.cameras.faulty import FaultyCamera
from renet.deploy.cameras.sim import SimCamera
from renet.deploy.controller import Controller
from renet.deploy.loop import run_control_loop
from renet.deploy.recording.reader import Recording, read_recording
from renet.deploy.recording.recorder import Recorder
from renet.deploy.recording.score import fallen
from renet.deploy.recording.tick import MODES
from renet.deploy.robots.sim.mujoco import MujocoRobot
from renet.deploy.robots.sim.scene import build_scene
from renet.deploy.safety.machine import Mode, SafetyMachine
from renet.deploy.safety.watchdog import interruptible
from renet.deploy.teleop import TeleopCommand
from renet.faults import FAULTS, Injection
from renet.interface import CONTROL_DT, TURN_GAIN
from renet.pilot.inference import InlineInference, ThreadedInference

EVERY = {
    "push": 8.0,
    "reading lost": 15.0,
    "reading late": 60.0,
    "control step late": 20.0,
    "reading not finite": 150.0,
    "camera stalls": 45.0,
    "camera's driver fails": 45.0,
}
"""Mean seconds between two; faults of the catalogue follow each other with gaps of 2 to 8 s."""
PATIENCE = 2.0
"""Seconds that the operator lets a damped robot lie."""
MMAP_THRESHOLD = -3
"""M_MMAP_THRESHOLD of glibc's mallopt: from so many bytes freed memory goes back at once."""
SETTLED = 5
"""Minutes after which memory may grow no more."""


@dataclass(frozen=True)
class Cfg:
    json: Path | None = None
    """File for the results."""
    plot: Path | None = None
    """Picture of the results; with --minutes 0 of those that the file holds already."""
    minutes: float = 60.0
    """Simulated; Ctrl-C and TERM end it earlier, with the results so far."""
    terrain: str = "obstacles"
    level: int = 3
    seed: int = 1
    wall: bool = False
    """An hour of the wall clock, beside flights that are killed or meet a full disk."""


class ShakyRobot(MujocoRobot):
    """Is pushed, answers late or not at all; keeps what goes wrong, when and how often."""

    def __init__(self, seed: int, *arguments) -> None:
        self.random, self.given = np.random.default_rng(seed), []
        super().__init__(*arguments)
        self._silent, self._held = -math.inf, super().read()
        self._start = self.data.qpos.copy()

    def strikes(self, what: str) -> bool:
        """Asked once in a control step."""
        struck = bool(self.random.random() < CONTROL_DT / EVERY[what])
        self.given += [(self.now(), what)] if struck else []
        return struck

    def read(self):
        state = super().read()
        if self.strikes("reading late"):
            self._silent = self.now() + self.random.uniform(0.02, 0.06)
        if self.strikes("reading lost"):
            return None
        if self.strikes("reading not finite"):
            return replace(state, joint_velocity=np.full(12, np.nan))
        self._held = self._held if self.now() < self._silent else state
        return self._held

    def wait(self, until: float) -> None:
        if self.strikes("push"):
            self.data.qvel[:2] += 0.5 * self.random.standard_normal(2)  # m/s
        if self.strikes("control step late"):
            until += self.random.uniform(0.0, 0.09)
        super().wait(until)

    def behind(self) -> float:
        """Seconds by which the simulation is late on the wall clock."""
        return time.monotonic() - self._begun - self.now()

    def put_back(self) -> None:
        """On its feet in the middle of the tile."""
        self.data.qpos[:], self.data.qvel[:] = self._start, 0.0


class ShakyCamera:
    """A simulated camera with one fault of the catalogue after the other, that also stalls."""

    def __init__(self, robot: ShakyRobot, bundle: Bundle) -> None:
        self._robot, self._camera = robot, SimCamera(robot, bundle.manifest.camera)
        self._over = self._stalled = -math.inf
        self._frame = None

    def latest(self):
        robot = self._robot
        now, random = robot.now(), robot.random
        if now >= self._over:
            fault, severity = str(random.choice(list(FAULTS))), int(random.integers(1, 6))
            robot.given.append((now, fault))
            gap, lasts = random.uniform(2.0, 8.0), random.uniform(0.5, 8.0)
            injection = Injection.of(fault, severity, round(gap / CONTROL_DT), lasts)
            seed, self._over = int(random.integers(2**31)), now + gap + lasts
            self._faulty = FaultyCamera(self._camera, [injection], robot.now, seed)
        if robot.strikes("camera stalls"):
            self._stalled = now + random.uniform(0.1, 3.0)
        if robot.strikes("camera's driver fails"):
            raise OSError("no device")
        if now >= self._stalled:
            self._frame = self._faulty.latest()
        return self._frame


class Operator:
    """Walks about the tile; stops a robot that falls, and helps and arms one that is damped."""

    def __init__(self, robot: ShakyRobot, machine: SafetyMachine) -> None:
        self._robot, self._machine = robot, machine
        self._since, self._tried, self.lifts = 0.0, 0, 0
        self._speed, self._goal = 0.0, np.zeros(2)

    def command(self, now: float) -> TeleopCommand:
        mode, upright = self._machine.mode, self._robot.base_rotation[2, 2] > 0.5
        waited = now - max(self._since, self._machine.since) > PATIENCE
        self._since = now if waited else self._since
        self._tried = 0 if mode is Mode.WALKING else self._tried + waited
        if waited and mode is Mode.DAMPING and (not upright or self._tried > 1):
            self._robot.put_back()
            # Armed at once it would rise from the joints it lay with, and topple.
            self._tried, waited = 0, False
            self.lifts += 1
        elif waited and mode is Mode.WALKING:
            self._speed = float(self._robot.random.choice((0.0, 0.3, 0.6, 0.6, 1.0)))
        if mode is Mode.DAMPING:
            return TeleopCommand(arm=waited)
        return TeleopCommand(self._speed, 0.0, self._turn_rate(), stop=not upright)

    def _turn_rate(self) -> float:
        """Turn towards the goal, which is another one once it is near, rad/s."""
        away = self._goal - self._robot.base_position[:2]
        if np.linalg.norm(away) < 1.0:
            self._goal = self._robot.random.uniform(-3.0, 3.0, 2)
        ahead = self._robot.base_rotation[:2, 0]
        turn = math.atan2(away[1], away[0]) - math.atan2(ahead[1], ahead[0])
        return TURN_GAIN * math.remainder(turn, math.tau)


def soak(cfg: Cfg, folder: Path) -> dict:
    """Run; returns the results, and leaves the recording in a folder."""
    bundle, begun = Bundle.load(), time.monotonic()
    model, ground = build_scene(cfg.terrain, cfg.level, seed=cfg.seed)
    robot = ShakyRobot(cfg.seed, model, bundle.manifest.robot, ground, cfg.wall)
    recorder = Recorder(folder / "recording.mcap", {"soak": cfg.seed}, patient=not cfg.wall)
    memory, loads, behind, cpu_ms = [], [], [0.0], array("d")
    end, flights = 60.0 * cfg.minutes, Flights(folder / "flights", cfg.seed)

    class Timed(Controller):
        def tick(self, *arguments):
            start = time.thread_time()
            command = super().tick(*arguments)
            cpu_ms.append(1000.0 * (time.thread_time() - start))
            return command

    def sample(command, state) -> None:
        behind[-1] = max(behind[-1], robot.behind())
        if robot.now() >= 60.0 * (len(memory) + 1):
            loads.append(round(os.getloadavg()[0], 1))
            behind.append(0.0)
            pages = int(Path("/proc/self/statm").read_text().split()[1])
            memory.append(round(pages * mmap.PAGESIZE / 2**20, 1))
            wall, done = (time.monotonic() - begun) / 60.0, len(memory)
            left = wall / done * (cfg.minutes - done)
            print(f"minute {done}: {memory[-1]} MB, {left:.0f} minutes left", flush=True)

    inference = ThreadedInference if cfg.wall else InlineInference
    controller = Timed(bundle, inference=inference, on_event=recorder.event)
    operator = Operator(robot, controller.machine)
    devices: tuple = (robot, ShakyCamera(robot, bundle), operator, controller, recorder)
    with interruptible() as interrupted:
        robot.connect()
        if cfg.wall:
            flights.start()
        run_control_loop(*devices, done=lambda: robot.now() >= end or interrupted(), on_step=sample)
    wall = (time.monotonic() - begun) / 60.0
    flights.stop()
    recorder.close()
    run = read_recording(recorder.path)
    rows = by_minute(run, memory, np.array(cpu_ms), robot)
    for row, load, late in zip(rows, loads, behind, strict=False):
        row |= {"load": load} | ({"behind_s": round(late, 2)} if cfg.wall else {})
    names = ("seconds_vp", "seconds_op", "switches", "falls", "stand_ups", "damped")
    why = Counter(re.sub(r"\d+", "N", e.why) for e in run.events if e.what == Mode.DAMPING)
    return {
        "simulated_minutes": round(robot.now() / 60.0, 2),
        "wall_minutes": round(wall, 1),
        **{name: round(sum(row[name] for row in rows), 1) for name in names},
        "lifts": operator.lifts,
        "memory_growth_mb_per_hour": growth(memory),
        "flights": dict(flights.count),
        "given": dict(Counter(what for _, what in robot.given)),
        "damped_because": dict(why.most_common()),
        "recording_mb": round(recorder.path.stat().st_size / 1e6, 1),
        "recording_problem": recorder.problem or ("" if run.complete else "incomplete"),
        "bundle_sha256": bundle.sha256,
        "by_minute": rows,
    }


def growth(memory: list[float]) -> float | None:
    """Slope of a line through memory by minute, MB an hour, once all is loaded."""
    settled = memory[SETTLED:]
    if len(settled) < 2:
        return None
    return round(60.0 * float(np.polyfit(range(len(settled)), settled, 1)[0]), 2)


def by_minute(run: Recording, memory: list, cpu_ms: np.ndarray, robot: ShakyRobot) -> list[dict]:
    """What the recording holds of each minute, beside the memory at its end."""
    ticks, limits, rows = run.ticks, robot.description, []
    half = (limits.upper - limits.lower) / 2
    share = np.abs((ticks["position"] - limits.lower - half) / half).max(axis=1)
    walking = ticks["mode"] == MODES.index(Mode.WALKING)
    down = fallen(ticks)
    falls = down & ~np.roll(down, 1)
    for minute, megabytes in enumerate(memory):
        now = ticks["now"] // 60.0 == minute
        told = Counter(event.what for event in run.events if event.time // 60.0 == minute)
        row = {
            "memory_mb": megabytes,
            "tick_cpu_p50_ms": round(float(np.median(cpu_ms[now])), 2),
            "tick_cpu_p99_ms": round(float(np.quantile(cpu_ms[now], 0.99)), 2),
            "seconds_vp": round(CONTROL_DT * (walking & ticks["vision"])[now].sum(), 1),
            "seconds_op": round(CONTROL_DT * (walking & ~ticks["vision"])[now].sum(), 1),
            "switches": told["blind"] + told["sees"],
            "falls": int(falls[now].sum()),
            "stand_ups": told[Mode.WALKING],
            "damped": told[Mode.DAMPING],
            "target": round(float(share[now].max()), 3),
            "given": dict(Counter(what for time, what in robot.given if time // 60.0 == minute)),
        }
        rows.append(row)
    return rows


def plot(results: dict, path: Path) -> None:
    """Memory, tick times, events and shares of the envelope, by minute."""
    from matplotlib.figure import Figure

    panels = {
        "memory, MB": ("memory_mb",),
        "control step,\nms of CPU time": ("tick_cpu_p50_ms", "tick_cpu_p99_ms"),
        "in the minute": ("switches", "damped", "falls"),
        "largest joint target,\nshare of the envelope": ("target",),
        "load of the\ncomputer": ("load",),
    }
    rows, figure = results["by_minute"], Figure(figsize=(9, 8), layout="constrained")
    axes = figure.subplots(len(panels), 1, sharex=True)
    for axis, (label, names) in zip(axes, panels.items(), strict=True):
        for name in names:
            axis.plot(range(1, len(rows) + 1), [row[name] for row in rows], label=name)
        axis.set(ylabel=label, ylim=(0, None))
        axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
    axes[-1].set_xlabel("simulated minute")
    disturbances = sum(results["given"].values())
    axes[0].set_title(f"{len(rows)} minutes, {disturbances:,} disturbances", loc="left")
    figure.savefig(path, dpi=100)


def main(cfg: Cfg) -> None:
    if cfg.minutes > 0:
        # Else malloc keeps the arrays of the densest simulated grass for good.
        ctypes.CDLL(None).mallopt(MMAP_THRESHOLD, 2**17)
        with tempfile.TemporaryDirectory() as folder:
            report(soak(cfg, Path(folder)), cfg.json)
    if cfg.plot is not None and cfg.json is not None:
        plot(json.loads(cfg.json.read_text()), cfg.plot)


if __name__ == "__main__":
    main(tyro.cli(Cfg))
