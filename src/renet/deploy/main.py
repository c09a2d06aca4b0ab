"""`renet deploy`: put a bundle on a robot, real or simulated; the same program for both."""

import os
import time
from contextlib import ExitStack, nullcontext, suppress
from datetime import datetime
from pathlib import Path

from renet.bundle import Bundle
from renet.deploy.cfg import DeployCfg
from renet.deploy.checklist import Checklist
from renet.deploy.controller import Controller, Event
from renet.deploy.devices import missing_devices, start_devices
from renet.deploy.display import CommandDisplay, VelocityDisplay
from renet.deploy.joint_display import JointDisplay
from renet.deploy.loop import brake, run_control_loop
from renet.deploy.realtime import realtime
from renet.deploy.recording.reader import read_recording
from renet.deploy.recording.recorder import Recorder
from renet.deploy.recording.score import SCORE, summary, write_score
from renet.deploy.recording.timeline import TIMELINE
from renet.deploy.robots.base import JointCommand, RobotState
from renet.deploy.safety.machine import Mode
from renet.deploy.safety.watchdog import HANGS, interruptible, watchdog
from renet.errors import RenetError, collected, demand_none, reason
from renet.folders import lock, move, new_folder
from renet.interface import CONTROL_DT
from renet.pilot.inference import InlineInference, ThreadedInference
from renet.terminal import Terminal, encodable

RECORDING = "recording.mcap"
"""File name of the recording."""
RESULTS = (RECORDING, SCORE, TIMELINE)
"""Names of a run's files."""
PRIORITY = 50
"""SCHED_FIFO priority of the control loop's thread; the sender of a real robot has 60."""


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
        with ExitStack() as stack:
            run = _Run(cfg, bundle, folder, started, stack)
            run.drive()
        recorder = run.recorder
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


class _Run:
    """One run from the start of its devices to their end."""

    def __init__(
        self, cfg: DeployCfg, bundle: Bundle, folder: Path, started: float, stack: ExitStack
    ) -> None:
        """Start the devices.

        Args:
            cfg: Settings of the run.
            bundle: Bundle that drives.
            folder: Folder of the recording.
            started: Time of the monotonic clock at which the program began, s.
            stack: Stack that closes all devices.
        """
        self.cfg = cfg
        self.bundle = bundle
        self.stack = stack
        self.terminal = Terminal()
        stack.callback(self.terminal.close)
        say = self.terminal.say
        checklist = Checklist(say, cfg.dry_run)
        checklist.passed(f"{bundle.name} is whole, and for this robot", started)
        devices = start_devices(cfg, bundle, say, stack, checklist)
        self.robot, self.camera, self.teleop = devices
        self.show_robot = getattr(self.robot, "show", lambda: None)
        self.commands = CommandDisplay(say)
        self.joints = JointDisplay(say)
        self.velocity = VelocityDisplay(self.terminal.status)
        _keep_earlier(folder)
        header = cfg.header(bundle)
        self.recorder = Recorder(folder / RECORDING, header, not cfg.live, self.robot.now())
        stack.callback(self.recorder.close)

    def drive(self) -> None:
        """Drive the robot to the end of the run."""
        cfg = self.cfg
        # A simulation with priority would starve the rest of the computer.
        priority = nullcontext("") if cfg.robot_cfg.simulated else realtime(PRIORITY)
        with priority as refused:
            if refused:
                self.terminal.say(refused)
            # Threads inherit the priority of the one that starts them: the loop waits for
            # vision's, which must not be the weaker one.
            inference = ThreadedInference if cfg.live else InlineInference
            self.controller = Controller(
                self.bundle, cfg.limits, inference, cfg.mode, self.tell, cfg.unseen, cfg.dry_run
            )
            self.stack.callback(self.controller.close)
            with interruptible() as self.interrupted, watchdog(self.abort) as self.alive:
                self.begun = self.robot.now()
                run_control_loop(
                    self.robot,
                    self.camera,
                    self.teleop,
                    self.controller,
                    self.recorder,
                    done=self.done,
                    on_step=self.show,
                    dry_run=cfg.dry_run,
                )

    def tell(self, event: Event) -> None:
        """Record an event of the controller, and print it."""
        self.recorder.event(event)
        self.terminal.say(f"{event.time - self.begun:8.2f} s  {event.what}: {event.why}")

    def show(self, command: JointCommand, state: RobotState | None) -> None:
        """Show a control step to the user, and to the watchdog that the loop goes on.

        A dry run prints commands and the joints that are moved by hand; an operator sees the
        velocity.
        """
        self.alive()
        self.show_robot()
        if self.cfg.dry_run:
            self.commands.step(command)
            self.joints.step(state)
        elif self.cfg.teleop != "auto":
            self.velocity.step(self.controller.decision, state)

    def done(self) -> bool:
        """Return True if the run is over: ended by the user, by its length, or damped for good."""
        if self.interrupted() or getattr(self.teleop, "quit", False):
            return True
        passed = self.robot.now() - self.begun
        if passed >= self.cfg.length - CONTROL_DT / 2:
            return True
        # Somebody may arm a damped robot again.
        machine = self.controller.machine
        if self.teleop.attended or machine.mode is not Mode.DAMPING:
            return False
        # A robot that is armed by itself rises within the first second, or was refused.
        return machine.since >= self.begun or (passed > 1.0 and not self.cfg.dry_run)

    def abort(self) -> None:
        """Brake the robot and close all devices, on another thread than the loop that hangs."""
        if not self.cfg.dry_run:
            brake(self.robot, self.controller)
        # If the robot's clock is what hangs, the event is lost.
        with suppress(Exception):
            self.tell(Event(self.robot.now(), Mode.DAMPING, HANGS))
        self.stack.close()


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
