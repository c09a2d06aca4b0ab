"""`renet deploy`: put a bundle on a robot, real or simulated; the same program for both."""

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from datetime import datetime
from itertools import count
from pathlib import Path
from typing import Any

from renet import __version__
from renet.bundle import Bundle
from renet.deploy.cfg import DeployCfg
from renet.deploy.controller import Controller, Event
from renet.deploy.devices import start_devices
from renet.deploy.inference import InlineInference, ThreadedInference
from renet.deploy.loop import run_control_loop
from renet.deploy.realtime import realtime
from renet.deploy.recording import Recorder, read_recording
from renet.deploy.robots.base import JointCommand
from renet.deploy.safety import Mode, SafetyMachine
from renet.deploy.score import SCORE, TIMELINE, write_score
from renet.errors import RenetError
from renet.folders import lock, move, new_folder
from renet.interface import CONTROL_DT, JOINTS
from renet.terminal import Terminal

RECORDING = "recording.log"
RESULTS = (RECORDING, SCORE, TIMELINE)
PRIORITY = 50
"""Of SCHED_FIFO, of the control loop's thread; the Go1's sender has 60."""
PRINT_EVERY = 25
"""Control steps between two printed commands of a dry run."""


def deploy(cfg: DeployCfg) -> Path:
    """Run; returns the folder of the results.

    Raises:
        RenetError: a combination that cannot work, a device that does not answer, a bad bundle.
    """
    cfg.check()
    bundle = Bundle.load(cfg.bundle)
    with ExitStack() as stack:
        terminal = Terminal()
        stack.callback(terminal.close)
        robot, camera, teleop, show = start_devices(cfg, bundle, terminal.say, stack)
        folder = cfg.out or Path("results/deploy") / f"{datetime.now():%Y-%m-%d_%H-%M-%S}"
        stack.enter_context(lock(folder))
        _keep_earlier(folder)
        path = folder / RECORDING
        recorder = Recorder(path, _header(cfg, bundle), patient=not cfg.live)
        stack.callback(recorder.close)

        def tell(event: Event) -> None:
            recorder.event(event)
            terminal.say(f"{event.time - begun:8.2f} s  {event.what}: {event.why}")

        inference = (ThreadedInference if cfg.live else InlineInference)(bundle.sessions)
        controller = Controller(bundle, cfg.limits, inference, cfg.selector, tell)
        stack.callback(controller.close)
        echo = printer(terminal.say) if cfg.dry_run else lambda command: None

        def on_step(command: JointCommand) -> None:
            echo(command)
            show()

        def done() -> bool:
            return (
                interrupted()
                or getattr(teleop, "quit", False)
                or _over(cfg, controller.machine, begun, robot.now())
            )

        # A simulation with priority would starve the rest of the computer.
        priority = nullcontext("") if cfg.driver.simulated else realtime(PRIORITY)
        with _interruptible() as interrupted, priority as refused:
            for line in filter(None, (refused, getattr(robot, "refused", ""))):
                terminal.say(line)
            begun = robot.now()
            run_control_loop(
                robot,
                camera,
                teleop,
                controller,
                recorder,
                done=done,
                on_step=on_step,
                dry_run=cfg.dry_run,
            )
    if recorder.problem:
        print(recorder.problem)
    if not recorder.hung:
        print(summary(write_score(read_recording(recorder.path), folder)))
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
            raise RenetError(f"cannot keep the earlier run in {out}: {error}") from error


def summary(score: dict[str, Any]) -> str:
    """A score in one line."""
    delays = ", ".join("never" if d is None else f"{d:.2f} s" for d in score["switch_delay_s"])
    parts = [
        f"walked {score['walking_seconds']:.1f} s and {score['distance_m']:.1f} m "
        f"({score['distance_from']})",
        f"on vision {score['vision_share']:.0%}",
        f"{score['memory_share']:.0%} from memory" if score["memory_share"] else "",
        f"from fault to OP {delays}" if delays else "",
        f"falls: {score['falls']}",
    ]
    return "; ".join(part for part in parts if part)


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


def _over(cfg: DeployCfg, machine: SafetyMachine, begun: float, now: float) -> bool:
    """The time is up, or nobody is there to arm a damped robot again."""
    passed = now - begun
    damped = machine.mode is Mode.DAMPING and (
        machine.since >= begun or (passed > 1.0 and not cfg.dry_run)
    )
    return passed >= cfg.length - CONTROL_DT / 2 or (damped and cfg.teleop == "auto")


def _header(cfg: DeployCfg, bundle: Bundle) -> dict[str, Any]:
    """What the recording says of the run."""
    selector = bundle.manifest.selector
    calibrated = selector.thresholds.get("reconstruction", selector.beta)
    return cfg.header() | {
        "renet": __version__,
        "bundle": bundle.name,
        "bundle_sha256": bundle.sha256,
        "models": bundle.manifest.sha256,
        "beta": selector.beta if cfg.selector == "paper" else calibrated,
    }


@contextmanager
def _interruptible() -> Iterator[Callable[[], bool]]:
    """Ctrl-C, Ctrl-Z, Ctrl-\\, a lost terminal, TERM, USR1 and USR2 ask the run to end, braking.

    Ctrl-Z, too: a stopped program could not brake. A second Ctrl-C interrupts.
    """
    asked = False

    def ask(number: int, frame: Any) -> None:
        nonlocal asked
        if asked and number == signal.SIGINT:
            raise KeyboardInterrupt
        asked = True

    names = ("INT", "TSTP", "QUIT", "TERM", "HUP", "USR1", "USR2")
    signals = [signal.Signals[f"SIG{name}"] for name in names]
    before = [signal.signal(number, ask) for number in signals]
    try:
        yield lambda: asked
    finally:
        for number, handler in zip(signals, before, strict=True):
            signal.signal(number, handler)
