"""An hour of the runtime in simulation, with everything at random that may go wrong.

Loop, controller, selector, vision, safety machine, recorder and the link to a Go1 of `renet deploy`
walk a Go1 in MuJoCo across a tile, on the simulated clock. Faults of the camera's catalogue come
and go, and so do those of sensors and motors. The trunk is pushed, readings, images, packets and
control steps are lost, late or damaged, motors heat up, the battery runs down, drivers fail, and
another robot answers. An operator steers, mends a robot that was braked, puts it back on its feet
and arms it, and starts the program again where the robot is braked for good.

Meanwhile every command, event and step is checked (`promises.py`). A breach ends with exit code 1.

With `--wall` the hour is one of the wall clock, and inference runs on a thread of its own, as on a
robot. Once a minute another `renet deploy` is killed, interrupted, or meets a full disk; all of
them write to one folder.
"""

from __future__ import annotations

import ctypes
import math
import mmap
import os
import re
import sys
import tempfile
import threading
import time
import warnings
from array import array
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from disturbances import Body, Failure, Means, ShakyCamera, ShakyRobot
from facts import errors_in_one_line, report
from flights import Flights
from promises import Promises, watch_warnings
from renet.bundle import Bundle
from renet.deploy.controller import Controller, Event
from renet.deploy.loop import run_control_loop
from renet.deploy.recording.reader import Recording, read_recording
from renet.deploy.recording.recorder import Recorder
from renet.deploy.recording.score import fallen
from renet.deploy.recording.tick import MODES
from renet.deploy.robots.base import JointCommand, RobotState
from renet.deploy.robots.sim.scene import build_scene
from renet.deploy.safety.machine import Mode, SafetyMachine
from renet.deploy.safety.watchdog import interruptible
from renet.deploy.teleop.base import TeleopCommand
from renet.errors import RenetError
from renet.files import MEGABYTE, read_object, write_atomically
from renet.interface import CONTROL_DT, TURN_GAIN
from renet.pilot.inference import InlineInference, ThreadedInference
from renet.robots import Robot

PATIENCE = 2.0
"""Seconds that the operator lets a damped robot lie."""
CARELESS = 0.2
"""Share of damped robots that are armed as they lie, out of order or not."""
MMAP_THRESHOLD = -3
"""M_MMAP_THRESHOLD of glibc's mallopt: from so many bytes freed memory goes back at once."""
TIMED = 7
"""Of so many control steps the CPU time of one is measured; vision has every fifth."""
SETTLED = 5
"""Minutes after which memory may grow no more."""
MAX_RESULT_SIZE = 64 * MEGABYTE
"""Largest file of results that is drawn, bytes."""
STEP = np.dtype([("now", "f8"), ("share", "f8"), ("vp", "?"), ("op", "?"), ("falls", "?")])
"""Summary of a control step: its time, s, the largest joint target as a share of the envelope, and
flags: VP drives the walk, OP does, the robot falls."""


@dataclass(frozen=True)
class Cfg:
    json: Path | None = None
    """File for the results."""
    plot: Path | None = None
    """Picture of the results, which needs --json; with --minutes 0 of those that the file holds
    already."""
    minutes: float = 60.0
    """Simulated; Ctrl-C and TERM end it earlier, with the results so far."""
    terrain: str = "obstacles"
    level: int = 3
    seed: int = 1
    means: Means = field(default_factory=Means)
    """How often things go wrong."""
    wall: bool = False
    """An hour of the wall clock, beside flights that are killed or meet a full disk."""


class Operator:
    """Walks about the tile; stops a robot that falls, and helps and arms one that is damped."""

    controls = "steers by itself"
    attended = True

    def __init__(self, robot: ShakyRobot, machine: SafetyMachine) -> None:
        self._robot = robot
        self._machine = machine
        self._since = robot.now()
        """Time of the last deed, s."""
        self._ready = True
        """True for a robot that was put back, and may be armed."""
        self._speed = 0.0
        self._goal = np.zeros(2)
        self.lifts = 0
        """How often the robot was put on its feet."""
        self.armed = False
        """True if the newest command asks to stand up."""
        self.quit = False
        """True once the program is to end."""

    def command(self, now: float) -> TeleopCommand:
        """Return the command at `now`, s."""
        self.armed = False
        machine = self._machine
        self.quit = self.quit or self._robot.strikes("program_ends")
        waited = now - max(self._since, machine.since) > PATIENCE
        if waited:
            self._since = now
        if machine.mode is Mode.DAMPING:
            if waited:
                self._help()
            return TeleopCommand(arm=self.armed)
        if waited and machine.mode is Mode.WALKING:
            self._speed = float(self._robot.random.choice((0.0, 0.3, 0.6, 0.6, 1.0)))
        return TeleopCommand(self._speed, 0.0, self._turn_rate(), stop=not self._upright)

    def drain(self, now: float) -> None:
        """Do nothing: nothing was asked for before the run."""

    @property
    def _upright(self) -> bool:
        return self._robot.body.base_rotation[2, 2] > 0.5

    def _help(self) -> None:
        """Mend a damped robot, put it on its feet, arm it, or end the program."""
        robot = self._robot
        if robot.link.problem:
            self.quit = True
        # Once it was put back, it is armed; if that is in vain, it is mended again.
        careless = robot.random.random() < CARELESS
        if self._ready or (careless and self._upright):
            self._ready = False
            self.armed = True
            return
        # Armed at once it would rise from the joints it lay with, and topple.
        robot.repair()
        robot.body.put_back()
        self._ready = True
        self.lifts += 1

    def _turn_rate(self) -> float:
        """Turn towards the goal, which is another one once it is near, rad/s."""
        body = self._robot.body
        away = self._goal - body.base_position[:2]
        if np.linalg.norm(away) < 1.0:
            self._goal = self._robot.random.uniform(-3.0, 3.0, 2)
        ahead = body.base_rotation[:2, 0]
        turn = math.atan2(away[1], away[0]) - math.atan2(ahead[1], ahead[0])
        return TURN_GAIN * math.remainder(turn, math.tau)


class TimedController(Controller):
    """Keeps the CPU time, ms, of some control steps."""

    cpu_ms: array[float]
    _steps = 0

    def tick(self, *arguments: Any) -> JointCommand:
        """Do one control step."""
        self._steps += 1
        # The clock of a thread is a call of the system, which takes its time.
        if self._steps % TIMED:
            return super().tick(*arguments)
        start = time.thread_time()
        command = super().tick(*arguments)
        self.cpu_ms.append(1000.0 * (time.thread_time() - start))
        return command


@dataclass
class Samples:
    """What the process uses, by minute."""

    begun: float = field(default_factory=time.monotonic)
    """Time of the wall clock at which the soak began, s."""
    memory: list[float] = field(default_factory=list)
    """MB at the end of each minute."""
    load: list[float] = field(default_factory=list)
    """Of the computer, likewise."""
    files: list[int] = field(default_factory=list)
    """Open files, likewise."""
    threads: list[int] = field(default_factory=list)
    """Threads, likewise."""
    behind: list[float] = field(default_factory=lambda: [0.0])
    """Seconds by which the simulation is late on the wall clock, at most, in each minute."""
    cpu: list[tuple[float, float]] = field(default_factory=list)
    """Median and 99th percentile of a control step's CPU time, ms, in each minute."""
    cpu_ms: array[float] = field(default_factory=lambda: array("d"))
    """CPU time of control steps of this minute, ms."""

    def look(self, robot: ShakyRobot, minutes: float) -> None:
        """Take a sample if a minute is over; `minutes` are all that the soak lasts."""
        self.behind[-1] = max(self.behind[-1], robot.body.behind())
        if robot.now() < 60.0 * (len(self.memory) + 1):
            return
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        self.memory.append(round(pages * mmap.PAGESIZE / 2**20, 1))
        self.load.append(round(os.getloadavg()[0], 1))
        self.files.append(len(os.listdir("/proc/self/fd")))
        self.threads.append(threading.active_count())
        self.behind.append(0.0)
        median, high = np.percentile(self.cpu_ms, (50, 99))
        self.cpu.append((round(float(median), 2), round(float(high), 2)))
        del self.cpu_ms[:]
        done = len(self.memory)
        left = (time.monotonic() - self.begun) / 60.0 / done * (minutes - done)
        print(f"minute {done}: {self.memory[-1]} MB, {left:.0f} minutes left", flush=True)


class Soak:
    """One soak: a robot, and the programs that drive it one after the other."""

    def __init__(self, cfg: Cfg, folder: Path) -> None:
        self.cfg = cfg
        self.bundle = Bundle.load()
        self.folder = folder
        self.samples = Samples()
        model, ground = build_scene(cfg.terrain, cfg.level, seed=cfg.seed)
        body = Body(cfg.seed, model, self.bundle.manifest.robot, ground, cfg.wall)
        self.promises = Promises(body.description)
        self.robot = ShakyRobot(cfg.seed, body, cfg.means, self._sent)
        self.camera = ShakyCamera(self.robot, self.bundle)
        self.flights = Flights(folder / "flights", cfg.seed)
        self.recordings: list[Path] = []
        self.lifts = 0
        self.problems: Counter[str] = Counter()
        """Problems of the recorders."""

    def run(self) -> None:
        """Drive the robot until the time is over, or Ctrl-C."""
        robot = self.robot
        end = 60.0 * self.cfg.minutes
        with warnings.catch_warnings(), interruptible() as interrupted:
            watch_warnings(self.promises)
            if self.cfg.wall:
                self.flights.start()
            while robot.now() < end and not interrupted():
                self._drive(lambda: robot.now() >= end or interrupted())
        self.flights.stop()

    def _drive(self, over: Callable[[], bool]) -> None:
        """Drive the robot with one program, until it ends or the time is over."""
        cfg = self.cfg
        robot = self.robot
        robot.connect()
        path = self.folder / f"recording-{len(self.recordings)}.mcap"
        self.recordings.append(path)
        recorder = Recorder(path, {"soak": cfg.seed}, patient=not cfg.wall, time=robot.now())

        def tell(event: Event) -> None:
            recorder.event(event)
            # The controller lets no listener's exception through: it must be kept here.
            with self.promises.checked():
                self.promises.event(event)
            if event.what in (Mode.DAMPING, "robot"):
                robot.alarm(event.why)

        def on_step(command: JointCommand, state: RobotState | None) -> None:
            robot.walking = controller.machine.mode is Mode.WALKING
            armed = operator.armed
            # While a program ends, nobody asks the operator.
            operator.armed = False
            with self.promises.checked():
                self.promises.step(command, armed)
                self.samples.look(robot, cfg.minutes)

        inference = ThreadedInference if cfg.wall else InlineInference
        controller = TimedController(self.bundle, inference=inference, on_event=tell)
        controller.cpu_ms = self.samples.cpu_ms
        operator = Operator(robot, controller.machine)
        self.promises.begin(controller, robot.link)
        devices = (robot, self.camera, operator, controller, recorder)
        run_control_loop(*devices, done=lambda: operator.quit or over(), on_step=on_step)
        controller.close()
        recorder.close()
        self.lifts += operator.lifts
        if recorder.problem:
            self.problems[recorder.problem] += 1

    def _sent(self, command: JointCommand) -> None:
        """Check a command on its way to the motors."""
        self.promises.sent(command, self.robot.now())


def soak(cfg: Cfg, folder: Path) -> dict[str, Any]:
    """Run; returns the results, and leaves the recordings in a folder."""
    hour = Soak(cfg, folder)
    hour.run()
    robot = hour.robot
    samples = hour.samples
    wall = (time.monotonic() - samples.begun) / 60.0
    parts, events, problems = read_all(hour.recordings, robot.description)
    problems += hour.problems
    rows = by_minute(np.concatenate(parts), events, samples, robot.given, cfg.wall)
    names = ("seconds_vp", "seconds_op", "switches", "falls", "stand_ups", "damped")
    why = Counter(re.sub(r"\d+(\.\d+)?", "N", e.why) for e in events if e.what == Mode.DAMPING)
    return {
        "simulated_minutes": round(robot.now() / 60.0, 2),
        "wall_minutes": round(wall, 1),
        **{name: round(sum(row[name] for row in rows), 1) for name in names},
        "lifts": hour.lifts,
        "programs": len(hour.recordings),
        "commands_checked": hour.promises.commands,
        "breaches": dict(hour.promises.broken),
        "first_breaches": hour.promises.first,
        "memory_growth_mb_per_hour": growth(samples.memory),
        "flights": dict(hour.flights.count),
        "given": dict(Counter(what for _, what in robot.given)),
        "hardware": hardware(robot.failures),
        "failures": [
            {**asdict(failure.fault), "walking": failure.walking, "outcome": failure.outcome}
            | {"braked": failure.braked, "why": failure.why}
            for failure in robot.failures
        ],
        "damped_because": dict(why.most_common()),
        "recording_mb": round(sum(path.stat().st_size for path in hour.recordings) / 1e6, 1),
        "recording_problems": dict(problems),
        "bundle_sha256": hour.bundle.sha256,
        "by_minute": rows,
    }


def read_all(paths: list[Path], robot: Robot) -> tuple[list[np.ndarray], list[Event], Counter[str]]:
    """Read recordings; returns what `summary` makes of each, all events, and problems."""
    parts: list[np.ndarray] = []
    events: list[Event] = []
    problems: Counter[str] = Counter()
    for path in paths:
        try:
            recording = read_recording(path)
        except RenetError as error:
            problems[str(error)] += 1
            continue
        if not recording.complete:
            problems["incomplete"] += 1
        parts.append(summary(recording, robot))
        events += recording.events
    return parts, events, problems


def summary(run: Recording, robot: Robot) -> np.ndarray:
    """Return [T] of dtype `STEP`: what counts of each control step."""
    ticks = run.ticks
    half = (robot.upper - robot.lower) / 2
    steps = np.zeros(len(ticks), STEP)
    walking = ticks["mode"] == MODES.index(Mode.WALKING)
    down = fallen(ticks)
    steps["now"] = ticks["now"]
    steps["share"] = np.abs((ticks["position"] - robot.lower - half) / half).max(axis=1)
    steps["vp"] = walking & ticks["vision"]
    steps["op"] = walking & ~ticks["vision"]
    steps["falls"][1:] = down[1:] & ~down[:-1]
    return steps


def growth(memory: list[float]) -> float | None:
    """Slope of a line through memory by minute, MB an hour, once all is loaded."""
    settled = memory[SETTLED:]
    if len(settled) < 2:
        return None
    return round(60.0 * float(np.polyfit(range(len(settled)), settled, 1)[0]), 2)


def hardware(failures: list[Failure]) -> dict[str, dict[str, int]]:
    """Count what became of faults of the hardware that began while the robot walked."""
    table: dict[str, Counter[str]] = {}
    for failure in failures:
        if not failure.walking:
            continue
        row = table.setdefault(f"{failure.fault.part} {failure.fault.kind}", Counter())
        row[failure.outcome] += 1
    return {name: dict(table[name]) for name in sorted(table)}


def by_minute(
    steps: np.ndarray,
    events: list[Event],
    samples: Samples,
    given: list[tuple[float, str]],
    wall: bool,
) -> list[dict[str, Any]]:
    """Rows of what the recordings hold of each minute, beside what the process uses at its end."""
    rows = []
    for minute, megabytes in enumerate(samples.memory):
        now = steps["now"] // 60.0 == minute
        told = Counter(event.what for event in events if event.time // 60.0 == minute)
        row = {
            "memory_mb": megabytes,
            "files": samples.files[minute],
            "threads": samples.threads[minute],
            "tick_cpu_p50_ms": samples.cpu[minute][0],
            "tick_cpu_p99_ms": samples.cpu[minute][1],
            "seconds_vp": round(CONTROL_DT * steps["vp"][now].sum(), 1),
            "seconds_op": round(CONTROL_DT * steps["op"][now].sum(), 1),
            "switches": told["blind"] + told["sees"],
            "falls": int(steps["falls"][now].sum()),
            "stand_ups": told[Mode.WALKING],
            "damped": told[Mode.DAMPING],
            "target": round(float(steps["share"][now].max()), 3),
            "given": dict(Counter(what for time, what in given if time // 60.0 == minute)),
            "load": samples.load[minute],
        }
        if wall:
            row["behind_s"] = round(samples.behind[minute], 2)
        rows.append(row)
    return rows


def plot(results: dict[str, Any], path: Path) -> None:
    """Memory, tick times, events and shares of the envelope, by minute.

    Raises:
        RenetError: No minute of the results is whole, or the picture cannot be written.
    """
    import matplotlib.pyplot as plt

    from renet.evaluation import figures

    panels = {
        "memory, MB": ("memory_mb",),
        "control step,\nms of CPU time": ("tick_cpu_p50_ms", "tick_cpu_p99_ms"),
        "in the minute": ("switches", "damped", "falls"),
        "largest joint target,\nshare of the envelope": ("target",),
        "load of the\ncomputer": ("load",),
    }
    rows = results["by_minute"]
    if not rows:
        raise RenetError("there is nothing to draw: the soak did not last for a minute")
    minutes = range(1, len(rows) + 1)
    with plt.rc_context(figures.STYLE):
        figure, axes = plt.subplots(
            len(panels), 1, figsize=(figures.FIGURE_WIDTH, 8.0), sharex=True
        )
        for axis, (label, names) in zip(axes, panels.items(), strict=True):
            most = 0.0
            for name in names:
                values = [row[name] for row in rows]
                most = max(most, *values)
                axis.plot(minutes, values, label=name)
            axis.set(ylabel=label, ylim=(0, 1.1 * most))
            above = {"loc": "lower right", "bbox_to_anchor": (1.0, 0.97), "ncols": len(names)}
            axis.legend(**above, fontsize=9)
        axes[-1].set_xlabel("simulated minute")
        disturbances = sum(results["given"].values())
        figure.suptitle(f"{len(rows)} minutes, {disturbances:,} disturbances", x=0.01, ha="left")
        write_atomically(path, figures.png(figure), "picture")


def main(cfg: Cfg) -> None:
    """Run, print and write the results; a breach ends with exit code 1.

    Raises:
        RenetError: An option is of no use, or a file cannot be read or written.
    """
    if cfg.plot is not None and cfg.json is None:
        raise RenetError("--plot draws a file of results: give --json, too")
    if cfg.plot is not None and 0 < cfg.minutes < 1:
        raise RenetError(f"--plot draws whole minutes: give --minutes above {cfg.minutes:g}")
    broken = False
    if cfg.minutes > 0:
        # Else malloc keeps the arrays of the densest simulated grass for good.
        ctypes.CDLL(None).mallopt(MMAP_THRESHOLD, 2**17)
        with tempfile.TemporaryDirectory() as folder:
            results = soak(cfg, Path(folder))
            report(results, cfg.json)
            broken = bool(results["breaches"] or results["recording_problems"])
    if cfg.plot is not None and cfg.json is not None:
        plot(read_object(cfg.json, "results", MAX_RESULT_SIZE), cfg.plot)
    if broken:
        sys.exit(1)


if __name__ == "__main__":
    with errors_in_one_line():
        main(tyro.cli(Cfg))
