"""`renet deploy`: put a bundle on a robot, real or simulated; the same program for both."""

import os
import time
from collections.abc import Callable
from contextlib import ExitStack, nullcontext, suppress
from datetime import datetime
from itertools import count
from pathlib import Path

from renet.bundle import Bundle
from renet.deploy.cfg import DeployCfg
from renet.deploy.checklist import Checklist
from renet.deploy.controller import Controller, Decision, Event
from renet.deploy.devices import missing_devices, start_devices
from renet.deploy.display import VelocityDisplay
from renet.deploy.loop import brake, run_control_loop
from renet.deploy.realtime import realtime
from renet.deploy.recording.reader import read_recording
from renet.deploy.recording.recorder import Recorder
from renet.deploy.recording.score import SCORE, summary, write_score
from renet.deploy.recording.timeline import TIMELINE
from renet.deploy.robots.base import JointCommand, RobotState
from renet.deploy.robots.joint_watch import JointWatch
from renet.deploy.safety.machine import Mode, SafetyMachine
from renet.deploy.safety.watchdog import HANGS, interruptible, watchdog
from renet.deploy.teleop import Teleop
from renet.errors import RenetError, collected, demand_none, reason
from renet.folders import lock, move, new_folder
from renet.interface import CONTROL_DT, JOINTS
from renet.pilot.inference import InlineInference, ThreadedInference
from renet.terminal import Terminal, encodable

RECORDING = "recording.mcap"
"""File name of the recording."""
RESULTS = (RECORDING, SCORE, TIMELINE)
"""Names of a run's files."""
PRIORITY = 50
"""SCHED_FIFO priority of the control loop's thread; the sender of a real robot has 60."""
PRINT_EVERY = 25
"""Number of control steps from one printed command of a dry run to the next."""


def deploy(cfg: DeployCfg) -> Path:
    """Run a bundle on a robot; returns the folder of the results.

    Raises:
        RenetError: The settings do not go together, a device does not answer, or the bundle cannot
            be used.
    """
    started = time.monotonic()
    bundle = _load_bundle(cfg)
    folder = cfg.out or Path("results/deploy") / f"{datetime.now():%Y-%m-%d_%H-%M-%S}"
    # Locked before a robot is touched, so that no other run writes here.
    with lock(folder):
        recorder = _drive(cfg, bundle, folder, started)
        if recorder.problem:
            print(encodable(recorder.problem))
        if not recorder.hung:
            print(encodable(summary(write_score(read_recording(recorder.path), folder))))
    return folder


def _load_bundle(cfg: DeployCfg) -> Bundle:
    """Load the bundle; a dry run that cannot begin names also the devices that are missing."""
    bundle = None
    problems: list[str] = []
    with collected(problems):
        bundle = cfg.load_bundle()
    if bundle is None and cfg.dry_run:
        problems += missing_devices(cfg, print)
    demand_none(problems)
    assert bundle is not None
    return bundle


def _drive(cfg: DeployCfg, bundle: Bundle, folder: Path, started: float) -> Recorder:
    """Start the devices, drive the robot to the end of the run, and close all.

    Args:
        cfg: Settings of the run.
        bundle: Bundle that drives.
        folder: Folder of the recording.
        started: Time of the monotonic clock at which the program began, s.

    Returns:
        The closed recorder.
    """
    with ExitStack() as stack:
        terminal = Terminal()
        stack.callback(terminal.close)
        checklist = Checklist(terminal.say, cfg.dry_run)
        checklist.passed(f"{bundle.name} is whole, and for this robot", started)
        robot, camera, teleop = start_devices(cfg, bundle, terminal.say, stack, checklist)
        _keep_earlier(folder)
        recorder = Recorder(folder / RECORDING, cfg.header(bundle), not cfg.live, robot.now())
        stack.callback(recorder.close)

        def tell(event: Event) -> None:
            recorder.event(event)
            terminal.say(f"{event.time - begun:8.2f} s  {event.what}: {event.why}")

        show_robot = getattr(robot, "show", lambda: None)
        show = _step_display(cfg, terminal)

        def on_step(command: JointCommand, state: RobotState | None) -> None:
            step()
            show_robot()
            show(command, state, controller.decision)

        def done() -> bool:
            ended = interrupted() or getattr(teleop, "quit", False)
            return ended or _over(cfg, controller.machine, teleop, begun, robot.now())

        def close() -> None:
            if not cfg.dry_run:
                brake(robot, controller)
            # If the robot's clock is what hangs, the event is lost.
            with suppress(Exception):
                tell(Event(robot.now(), Mode.DAMPING, HANGS))
            stack.close()

        # A simulation with priority would starve the rest of the computer.
        priority = nullcontext("") if cfg.driver.simulated else realtime(PRIORITY)
        with priority as refused:
            if refused:
                terminal.say(refused)
            # Threads inherit the priority of the one that starts them: the loop waits for
            # vision's, which must not be the weaker one.
            inference = ThreadedInference if cfg.live else InlineInference
            controller = Controller(bundle, cfg.limits, inference, cfg.mode, tell, cfg.unseen)
            stack.callback(controller.close)
            with interruptible() as interrupted, watchdog(close) as step:
                begun = robot.now()
                devices = (robot, camera, teleop, controller, recorder)
                run_control_loop(*devices, done=done, on_step=on_step, dry_run=cfg.dry_run)
    return recorder


def _step_display(
    cfg: DeployCfg, terminal: Terminal
) -> Callable[[JointCommand, RobotState | None, Decision], None]:
    """Make the function that shows each control step to the user.

    A dry run prints commands and the joints that are moved by hand; an operator sees the velocity.
    """
    print_command = printer(terminal.say)
    watch = JointWatch(terminal.say)
    velocity = VelocityDisplay(terminal.status)

    def show(command: JointCommand, state: RobotState | None, decision: Decision) -> None:
        if cfg.dry_run:
            print_command(command)
            watch.look(state)
        elif cfg.teleop != "auto":
            velocity.step(decision, state)

    return show


def _keep_earlier(out: Path) -> None:
    """Move an earlier run's results into a folder of their own, for they may explain a crash."""
    results = [out / name for name in RESULTS if os.path.lexists(out / name)]
    if not results:
        return
    number = 1
    while os.path.lexists(out / f"earlier-{number}"):
        number += 1
    earlier = out / f"earlier-{number}"
    try:
        new_folder(earlier)
        for path in results:
            move(path, earlier / path.name)
    except OSError as error:
        raise RenetError(f"cannot keep the earlier run in {out}: {reason(error)}") from error


def printer(say: Callable[[str], None]) -> Callable[[JointCommand], None]:
    """Make the function that says twice a second what a dry run would command, if it is new."""
    steps = count()
    said = ""

    def show(command: JointCommand) -> None:
        nonlocal said
        if next(steps) % PRINT_EVERY != 0:
            return
        pairs = zip(JOINTS, command.position, command.stiffness, strict=True)
        parts = []
        for name, position, stiffness in pairs:
            parts.append(f"{name.removesuffix('_joint')} {position:+.2f} (Kp {stiffness:.0f})")
        line = "  ".join(parts)
        if line != said:
            said = line
            say(line)

    return show


def _over(cfg: DeployCfg, machine: SafetyMachine, teleop: Teleop, begun: float, now: float) -> bool:
    """Return True if the time is up, or nobody is there to arm a damped robot again."""
    passed = now - begun
    # A robot that is armed by itself rises within the first second, or was refused.
    damped = machine.mode is Mode.DAMPING and (
        machine.since >= begun or (passed > 1.0 and not cfg.dry_run)
    )
    return passed >= cfg.length - CONTROL_DT / 2 or (damped and not teleop.attended)
