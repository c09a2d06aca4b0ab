"""`renet deploy`: put a bundle on a robot, real or simulated; the same program for both."""

import math
import os
import signal
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import asdict, dataclass, field, replace
from datetime import datetime
from itertools import count
from pathlib import Path
from typing import Any, Literal

import tyro

from renet import __version__
from renet.bundle import Bundle
from renet.deploy.controller import Controller, Event
from renet.deploy.devices import start_devices
from renet.deploy.inference import InlineInference, ThreadedInference
from renet.deploy.loop import run_control_loop
from renet.deploy.realtime import realtime
from renet.deploy.recording import Recorder, read_recording
from renet.deploy.robots.base import JointCommand
from renet.deploy.robots.go1 import POWER_LEVEL, ROBOT_HOST
from renet.deploy.safety import Mode, SafetyCfg, SafetyMachine
from renet.deploy.score import SCORE, TIMELINE, write_score
from renet.deploy.teleop import MAX_SPEED
from renet.errors import RenetError
from renet.faults import parse_fault
from renet.folders import lock, move, new_folder
from renet.interface import CONTROL_DT, JOINTS
from renet.server import LOOPBACK
from renet.terminal import Terminal

RECORDING = "recording.log"
RESULTS = (RECORDING, SCORE, TIMELINE)
PRIORITY = 50
"""Of SCHED_FIFO, of the control loop's thread; the Go1's sender has 60."""
SHORT_RUN = 15.0
"""Seconds of a run that nobody steers."""
DEADMAN = 5.0
"""Seconds that a real robot goes on without a sign of its operator."""
LIMP = 10.0
"""rad; farther than any joint can be from the default pose."""
PRINT_EVERY = 25
"""Control steps between two printed commands of a dry run."""


@dataclass(frozen=True)
class DeployCfg:
    """Run a bundle on a robot; leaves a recording, a timeline and a score."""

    bundle: tyro.conf.Positional[Path | None] = None
    """Bundle folder; the one that ships with renet by default."""
    robot: Literal["mujoco", "pybullet", "go1"] = "mujoco"
    """mujoco, pybullet: simulated in this process. go1: a Unitree Go1 in low-level mode."""
    camera: Literal["auto", "sim", "realsense", "replay", "none"] = "auto"
    """auto: sim for a simulated robot, realsense for go1."""
    teleop: Literal["auto", "keyboard", "joystick"] = "auto"
    """auto: stands up and walks straight ahead (simulation only)."""
    deadman: float | None = None
    """Seconds without a key or a move of the joystick after which the robot stands until there is
    one; 5 by default with a real robot, no limit in simulation. inf: no limit."""
    out: Path | None = None
    """Folder of the results, results/deploy/DATE_TIME by default; what an earlier run left in
    it is kept in its subfolders earlier-1, earlier-2, ..."""
    seconds: float | None = None
    """Length of the run on the robot's clock; 15 s by default, with an operator no end. Ctrl-C
    and the keyboard's q end it earlier, braked and logged."""
    speed: float = 0.6
    """Forward speed of the auto operator, 0 to 1 m/s."""
    terrain: str = "flat"
    """Simulation: flat, rough, obstacles, stairs (down from a summit; stairs_up: out of a pit),
    gap, platform."""
    level: int = 1
    """Simulation: level of the terrain, 1 to 10."""
    scene: Path | None = None
    """Simulation: an MJCF file to use as terrain instead."""
    fault: tuple[str, ...] = ()
    """What goes wrong with the camera: NAME[:SEVERITY]@SECONDS[+DURATION], e.g. blackout@5s,
    glare:3@4s+2s."""
    recording: Path | None = None
    """Recording whose images the replay camera shows."""
    selector: Literal["monitors", "paper"] = "monitors"
    """monitors: all monitors, with a dwell before vision returns. paper: the reconstruction loss
    alone."""
    real_time: bool = False
    """Simulation: pace it to the wall clock, as operators and the viewer always do."""
    serial: str = ""
    """RealSense: serial number of the one to use; the only one by default."""
    viewer: bool = False
    """Simulation: show it in a browser."""
    dry_run: bool = False
    """Print commands and never move the robot."""
    host: str = LOOPBACK
    """Address at which the viewer listens; 0.0.0.0: to everybody on the network."""
    robot_host: str = ROBOT_HOST
    """Go1: address of its motor board."""
    power_level: int = POWER_LEVEL
    """Go1: of the vendor's own overload guard, 1 (10 % of the motors' power) to 10."""
    seed: int = 1
    """Of the simulated camera's noise, the terrain and the faults."""
    safety: SafetyCfg = field(default_factory=SafetyCfg)
    """Limits."""

    @property
    def simulated(self) -> bool:
        """The robot lives in this process."""
        return self.robot != "go1"

    @property
    def live(self) -> bool:
        """The robot's clock is the wall's."""
        return not self.simulated or self.real_time or self.viewer or self.teleop != "auto"

    @property
    def length(self) -> float:
        """Seconds after which the run ends by itself."""
        steered = math.inf if self.teleop != "auto" else SHORT_RUN
        return steered if self.seconds is None else self.seconds

    @property
    def operator_timeout(self) -> float:
        """Seconds without a sign of the operator after which the robot stands."""
        default = math.inf if self.simulated else DEADMAN
        return default if self.deadman is None else self.deadman

    @property
    def limits(self) -> SafetyCfg:
        """Of the controller: the joints of a dry run follow nobody."""
        return replace(self.safety, max_stand_up_error=LIMP) if self.dry_run else self.safety


def deploy(cfg: DeployCfg) -> Path:
    """Run; returns the folder of the results.

    Raises:
        RenetError: a combination that cannot work, a device that does not answer, a bad bundle.
    """
    _check(cfg)
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
        priority = nullcontext("") if cfg.simulated else realtime(PRIORITY)
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


def _check(cfg: DeployCfg) -> None:
    """Refuse what cannot work before anything moves or is written."""
    if not cfg.length > 0:
        raise RenetError(f"--seconds must be positive, got {cfg.seconds}")
    if not cfg.operator_timeout > 0:
        raise RenetError(f"--deadman must be positive, got {cfg.deadman}")
    if not 0.0 <= cfg.speed <= MAX_SPEED:
        raise RenetError(f"--speed must be from 0 to {MAX_SPEED:g} m/s, got {cfg.speed}")
    if cfg.seed < 0:
        raise RenetError(f"--seed must not be negative, got {cfg.seed}")
    if cfg.viewer and cfg.robot == "pybullet":
        raise RenetError("--viewer shows MuJoCo's simulation: use --robot mujoco")
    if not cfg.simulated:
        if cfg.camera == "sim":
            raise RenetError("--camera sim looks at a simulation: use realsense, replay or none")
        if cfg.host != LOOPBACK:
            raise RenetError("--host is the viewer's address: the robot's is --robot-host")
        if cfg.viewer:
            raise RenetError("--viewer shows a simulation: with a real robot look at the robot")
        if cfg.teleop == "auto" and not cfg.dry_run:
            raise RenetError("a real robot needs --teleop keyboard or joystick, or --dry-run")
    if cfg.camera == "replay" and cfg.recording is None:
        raise RenetError("--camera replay needs --recording, whose images it shows")
    if cfg.fault and cfg.camera == "none":
        raise RenetError("--fault needs a camera to spoil")
    for text in cfg.fault:
        parse_fault(text)


def _header(cfg: DeployCfg, bundle: Bundle) -> dict[str, Any]:
    selector = bundle.manifest.selector
    calibrated = selector.thresholds.get("reconstruction", selector.beta)
    return {
        "renet": __version__,
        "bundle": bundle.name,
        "bundle_sha256": bundle.sha256,
        "models": bundle.manifest.sha256,
        "beta": selector.beta if cfg.selector == "paper" else calibrated,
        "safety": asdict(cfg.limits),
        "selector": cfg.selector,
        "robot": cfg.robot,
        "camera": cfg.camera,
        "terrain": cfg.terrain,
        "level": cfg.level,
        "scene": str(cfg.scene) if cfg.scene else None,
        "fault": list(cfg.fault),
        "onsets": [parse_fault(text).onset * CONTROL_DT for text in cfg.fault],
        "seed": cfg.seed,
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
