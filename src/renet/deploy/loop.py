"""The 50 Hz loop around the controller: read, decide, write, record, wait.

Whatever a device does, the loop goes on: a robot that cannot be read is damped by the controller,
a camera that fails costs vision. However the loop ends, its last commands brake.
"""

import math
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from renet.deploy.cameras.base import Camera, DepthFrame
from renet.deploy.controller import Controller
from renet.deploy.recording.recorder import Recorder
from renet.deploy.robots.base import JointCommand, RobotState
from renet.deploy.robots.driver import RobotDriver
from renet.deploy.robots.envelope import clamp, demand_within
from renet.deploy.safety.checks import pre_arm_problem
from renet.deploy.safety.machine import ENDED, EXHAUSTED, REFUSED, Mode, damping_command
from renet.deploy.teleop import Teleop, TeleopCommand
from renet.deploy.watch.power import PowerWatch
from renet.interface import CONTROL_DT

BRAKING = 25
"""Control steps of braking with which every run ends (0.5 s)."""
ATTEMPTS = 5
"""Braking commands tried where the loop itself failed."""


def run_control_loop(
    robot: RobotDriver,
    camera: Camera | None,
    teleop: Teleop,
    controller: Controller,
    recorder: Recorder | None = None,
    *,
    done: Callable[[], bool] = lambda: False,
    on_step: Callable[[JointCommand, RobotState | None], None] = lambda command, state: None,
    dry_run: bool = False,
) -> None:
    """Drive a connected robot, with a started camera if there is one, until `done`; then brake.

    `done` is asked at every control step; `on_step` is told every command and the reading before
    it. A dry run never writes to the robot.

    Raises:
        RenetError: the bundle asks for more than the robot takes. Whatever `done` or the robot's
            `wait` raise, and KeyboardInterrupt, pass after the robot was told to brake.
    """
    demand_within(robot.description, controller.robot)
    loop = _Loop(robot, camera, teleop, controller, recorder, dry_run)
    due, braking = robot.now(), 0
    try:
        while braking < BRAKING:
            braking += braking > 0 or done()
            command, state = loop.step(robot.now(), ending=braking > 0)
            with suppress(Exception):  # A closed terminal must not end a run.
                on_step(command, state)
            due = next_step(robot, due)
    except BaseException:
        if not dry_run:
            brake(robot, controller)
        raise


def brake(robot: RobotDriver, controller: Controller) -> None:
    """Tell a robot to brake, whatever failed before."""
    command = damping_command(controller.robot, controller.cfg)
    for _ in range(ATTEMPTS):
        with suppress(Exception):
            robot.write(clamp(robot.description, command))
            return


@dataclass
class _Loop:
    """One run: its devices, and what each of them last had to say."""

    robot: RobotDriver
    camera: Camera | None
    teleop: Teleop
    controller: Controller
    recorder: Recorder | None
    dry_run: bool
    _problems: dict[str, str] = field(default_factory=dict)
    _refused: bool = False

    def __post_init__(self) -> None:
        self._power = PowerWatch(self.controller.cfg)

    def step(self, now: float, ending: bool) -> tuple[JointCommand, RobotState | None]:
        """One control step; returns what was commanded and what was read before."""
        controller = self.controller
        if ending:
            controller.trip(ENDED, now)
        state = self._ask("robot", self.robot.read, None)
        frame = None if self.camera is None else self._ask("camera", self._look, None)
        wish = self._ask("teleop", lambda: self._listen(now), TeleopCommand(stop=True))
        if ending:
            wish = TeleopCommand(stop=True)  # Also so that a replay of the recording brakes here.
        wish = self._checked(wish, state, frame, now)
        begun = time.perf_counter()
        command = controller.tick(state, frame, wish, now)
        compute_ms = 1000.0 * (time.perf_counter() - begun)
        if not self.dry_run:
            self._write(command, state, now)
            self._look_at_power(state, now)
        if self.recorder is not None:
            with suppress(Exception):  # Out of memory, for one: walk on without the recording.
                where = getattr(self.robot, "base_position", None)  # Simulated robots know.
                decision = controller.decision
                self.recorder.append(state, frame, wish, now, decision, compute_ms, where)
            self._complain("recorder", self.recorder.problem)
        return command, state

    def _look(self) -> DepthFrame | None:
        self.camera.busy = self.controller.machine.mode is not Mode.DAMPING
        frame = self.camera.latest()
        self._complain("camera", getattr(self.camera, "problem", ""))
        return frame

    def _listen(self, now: float) -> TeleopCommand:
        wish = self.teleop.command(now)
        self._complain("teleop", getattr(self.teleop, "problem", ""))
        return wish

    def _checked(
        self, wish: TeleopCommand, state: RobotState | None, frame: DepthFrame | None, now: float
    ) -> TeleopCommand:
        """The operator's command, without a wish to stand up that the pre-arm check refuses.

        A refused button must be released first: nothing arms by itself once the check passes.
        """
        arming = getattr(wish, "arm", False) and self.controller.machine.mode is Mode.DAMPING
        if not arming:
            self._refused = False
            return wish
        if not self._refused and not self.dry_run:
            recording = "" if self.recorder is None else self.recorder.problem
            camera, cfg = self.camera is not None, self.controller.cfg
            given = (state, wish, frame, camera, recording, cfg, now)
            problem = self._ask("arming", lambda: pre_arm_problem(*given), "a device says nonsense")
            self._refused = bool(problem)
            if problem:
                self.controller.tell(now, "refused", problem)
        return TeleopCommand() if self._refused else wish

    def _write(self, command: JointCommand, state: RobotState | None, now: float) -> None:
        try:
            if self.robot.now() - now > self.controller.cfg.max_gap:  # Its reading is as old.
                command = damping_command(self.controller.robot, self.controller.cfg)
            self.robot.write(clamp(self.robot.description, command, state))
        except Exception as error:
            self.controller.trip(f"{REFUSED}: {error}", now)

    def _look_at_power(self, state: RobotState | None, now: float) -> None:
        """Say that battery or motors are near their limits, and lie down before they fail."""
        self._power.look(state)
        self._complain("power", self._power.warning)
        if self._power.end:
            self.controller.trip(f"{EXHAUSTED}: {self._power.end}", now)

    def _ask(self, device: str, question: Callable[[], Any], otherwise: Any) -> Any:
        """A device's answer; one that fails says nothing, an operator's that fails says stop."""
        try:
            return question()
        except Exception as error:
            self._complain(device, f"{type(error).__name__}: {error}")
            return otherwise

    def _complain(self, device: str, why: str) -> None:
        """Tell what a device has to say when it says something else than before."""
        if why and self._problems.get(device) != why:
            self.controller.tell(self.robot.now(), device, why)
        self._problems[device] = why


def next_step(robot: RobotDriver, due: float) -> float:
    """Wait for the control step after the one that was due at `due`; returns when that is due.

    A step that is missed is left out: two in quick succession help no robot.
    """
    due += CONTROL_DT * (math.floor((robot.now() - due) / CONTROL_DT + 0.1) + 1)
    robot.wait(due)
    return due
