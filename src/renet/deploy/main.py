"""`renet deploy`: put a bundle on a robot, real or simulated; the same program for both."""

import os
import time
from collections.abc import Callable
from contextlib import ExitStack, nullcontext, suppress
from datetime import datetime
from itertools import count
from pathlib import Path

from renet.deploy.cfg import DeployCfg
from renet.deploy.checklist import Checklist
from renet.deploy.controller import Controller, Event
from renet.deploy.devices import start_devices
from renet.deploy.display import VelocityDisplay
from renet.deploy.loop import brake, run_control_loop
from renet.deploy.realtime import realtime
from renet.deploy.recording.reader import read_recording
from renet.deploy.recording.recorder import Recorder
from renet.deploy.recording.score import SCORE, TIMELINE, summary, write_score
from renet.deploy.robots.base import JointCommand, RobotState
from renet.deploy.robots.joint_watch import JointWatch
from renet.deploy.safety.machine import Mode, SafetyMachine
from renet.deploy.safety.watchdog import HANGS, interruptible, watchdog
from renet.deploy.teleop import Teleop
from renet.errors import RenetError, reason
from renet.folders import lock, move, new_folder
from renet.interface import CONTROL_DT, JOINTS
from renet.pilot.inference import InlineInference, ThreadedInference
from renet.terminal import Terminal, encodable

RECORDING = "recording.mcap"
RESULTS = (RECORDING, SCORE, TIMELINE)
PRIORITY = 50
"""Priority of the control loop's thread under SCHED_FIFO; the senders of robots have 60."""
PRINT_EVERY = 25
"""Control steps between two printed commands of a dry run."""


def deploy(cfg: DeployCfg) -> Path:
    """Run; returns the folder of the results.

    Raises:
        RenetError: a combination that cannot work, a device that does not answer, a bad bundle.
    """
    started = time.monotonic()
    bundle = cfg.load_bundle()
    folder = cfg.out or Path("results/deploy") / f"{datetime.now():%Y-%m-%d_%H-%M-%S}"
    with lock(folder):  # From before a robot is touched.
        with ExitStack() as stack:
            terminal = Terminal()
            stack.callback(terminal.close)
            checklist = Checklist(terminal.say, cfg.dry_run)
            checklist.passed(f"{bundle.name} is whole, and for this robot", started)
            robot, camera, teleop = start_devices(cfg, bundle, terminal.say, stack, checklist)
            _keep_earlier(folder)
            path = folder / RECORDING
            recorder = Recorder(path, cfg.header(bundle), not cfg.live, robot.now())
            stack.callback(recorder.close)

            def tell(event: Event) -> None:
                recorder.event(event)
                terminal.say(f"{event.time - begun:8.2f} s  {event.what}: {event.why}")

            show = getattr(robot, "show", lambda: None)
            echo, watch = printer(terminal.say), JointWatch(terminal.say)
            velocity = VelocityDisplay(terminal.status)

            def on_step(command: JointCommand, state: RobotState | None) -> None:
                step()
                show()
                if cfg.dry_run:
                    echo(command)
                    watch.look(state)
                elif cfg.teleop != "auto":
                    velocity.step(controller.decision, state)

            def done() -> bool:
                ended = interrupted() or getattr(teleop, "quit", False)
                return ended or _over(cfg, controller.machine, teleop, begun, robot.now())

            def close() -> None:
                if not cfg.dry_run:
                    brake(robot, controller)
                with suppress(Exception):  # What hangs may be the robot's clock.
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
        if recorder.problem:
            print(encodable(recorder.problem))
        if not recorder.hung:
            print(encodable(summary(write_score(read_recording(recorder.path), folder))))
    return folder


def _keep_earlier(out: Path) -> None:
    """Move an earlier run's results into a folder of their own: the one before a crash matters."""
    results = [path for name in RESULTS if os.path.lexists(path := out / name)]
    if results:
        earlier = next(p for n in count(1) if not os.path.lexists(p := out / f"earlier-{n}"))
        try:
            new_folder(earlier)
            for path in results:
                move(path, earlier / path.name)
        except OSError as error:
            raise RenetError(f"cannot keep the earlier run in {out}: {reason(error)}") from error


def printer(say: Callable[[str], None]) -> Callable[[JointCommand], None]:
    """Says every half second what a dry run would command, if it is something else than before."""
    steps, said = count(), ""

    def show(command: JointCommand) -> None:
        nonlocal said
        pairs = zip(JOINTS, command.position, command.stiffness, strict=True)
        parts = [f"{n.removesuffix('_joint')} {p:+.2f} (Kp {k:.0f})" for n, p, k in pairs]
        if next(steps) % PRINT_EVERY == 0 and (line := "  ".join(parts)) != said:
            said = line
            say(line)

    return show


def _over(cfg: DeployCfg, machine: SafetyMachine, teleop: Teleop, begun: float, now: float) -> bool:
    """The time is up, or nobody is there to arm a damped robot again."""
    passed = now - begun
    damped = machine.mode is Mode.DAMPING and (
        machine.since >= begun or (passed > 1.0 and not cfg.dry_run)
    )
    return passed >= cfg.length - CONTROL_DT / 2 or (damped and not teleop.attended)
