"""The 50 Hz loop around the controller: read, decide, write, record, wait.

The loop goes on whatever a device does: the controller brakes a robot that cannot be read, and
walks blind if the camera fails. However the loop ends, its last commands brake.
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
from renet.deploy.robots.base import JointCommand, RobotDriver, RobotState
from renet.deploy.robots.envelope import clamp, demand_within
from renet.deploy.safety.checks import pre_arm_problem
from renet.deploy.safety.machine import ENDED, EXHAUSTED, REFUSED, Mode, damping_command
from renet.deploy.teleop.base import Teleop, TeleopCommand
from renet.deploy.watch.power import PowerWatch
from renet.interface import CONTROL_DT

BRAKING = 25
"""Number of braking control steps at the end of every run, 0.5 s."""
ATTEMPTS = 5
"""Number of attempts to brake after the loop itself failed."""


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
    """Drive a robot until `done`, then brake.

    Args:
        robot: Connected robot.
        camera: Started camera; None without one.
        teleop: The operator's device.
        controller: Controller in DAMPING.
        recorder: Recorder of the run; None without one.
        done: Function that is asked at every control step if the run is over.
        on_step: Function that is called with every command and the reading before it.
        dry_run: Never write to the robot.

    Raises:
        RenetError: The bundle asks for more than the robot takes. Exceptions of `done` and of the
            robot's `wait`, and KeyboardInterrupt, are raised again after the robot was told to
            brake.
    """
    demand_within(robot.description, controller.robot)
    loop = _Loop(robot, camera, teleop, controller, recorder, dry_run)
    due = robot.now()
    braking = 0
    try:
        while braking < BRAKING:
            # Once the run is over, count the steps of its end.
            braking += braking > 0 or done()
            command, state = loop.step(robot.now(), ending=braking > 0)
            # A closed terminal must not end a run.
            with suppress(Exception):
                on_step(command, state)
            due = next_step(robot, due)
    except BaseException:
        if not dry_run:
            brake(robot, controller)
        raise


def brake(robot: RobotDriver, controller: Controller) -> None:
    """Tell a robot to brake, and try again if that fails."""
    command = damping_command(controller.robot, controller.cfg)
    for _ in range(ATTEMPTS):
        with suppress(Exception):
            robot.write(clamp(robot.description, command))
            return


@dataclass
class _Loop:
    """One run: its devices, and the last problem of each."""

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
        """Do one control step; returns the command and the reading before it."""
        controller = self.controller
        if ending:
            controller.trip(ENDED, now)
        state = self._ask("robot", self.robot.read, None)
        frame = None if self.camera is None else self._ask("camera", self._look, None)
        # At the end nobody is asked. The recording must say it, so that its replay brakes, too.
        wish = TeleopCommand(stop=True)
        if not ending:
            wish = self._ask("teleop", lambda: self._listen(now), wish)
        wish = self._checked(wish, state, frame, now)
        begun = time.perf_counter()
        command = controller.tick(state, frame, wish, now)
        compute_ms = 1000.0 * (time.perf_counter() - begun)
        if not self.dry_run:
            self._write(command, state, now)
            self._look_at_power(state, now)
        if self.recorder is not None:
            # Walk on without the recording if it fails, for example for want of memory.
            with suppress(Exception):
                # Only a simulated robot knows where it is.
                where = getattr(self.robot, "base_position", None)
                decision = controller.decision
                self.recorder.append(state, frame, wish, now, decision, compute_ms, where)
            self._complain("recorder", self.recorder.problem)
        return command, state

    def _look(self) -> DepthFrame | None:
        """Return the camera's newest frame; a damped robot's camera may open itself anew."""
        self.camera.busy = self.controller.machine.mode is not Mode.DAMPING
        frame = self.camera.latest()
        self._complain("camera", getattr(self.camera, "problem", ""))
        return frame

    def _listen(self, now: float) -> TeleopCommand:
        """Return the operator's newest command."""
        wish = self.teleop.command(now)
        self._complain("teleop", getattr(self.teleop, "problem", ""))
        return wish

    def _checked(
        self, wish: TeleopCommand, state: RobotState | None, frame: DepthFrame | None, now: float
    ) -> TeleopCommand:
        """Return the operator's command, without a wish to stand up that the pre-arm check refuses.

        After a refusal the button must be released first: nothing arms by itself once the check
        passes.
        """
        arming = getattr(wish, "arm", False) and self.controller.machine.mode is Mode.DAMPING
        if not arming:
            self._refused = False
            return wish
        if not self._refused and not self.dry_run:
            recording = "" if self.recorder is None else self.recorder.problem
            has_camera = self.camera is not None
            given = (state, wish, frame, has_camera, recording, self.controller.cfg, now)
            problem = self._ask("arming", lambda: pre_arm_problem(*given), "a device says nonsense")
            self._refused = bool(problem)
            if problem:
                self.controller.tell(now, "refused", problem)
        return TeleopCommand() if self._refused else wish

    def _write(self, command: JointCommand, state: RobotState | None, now: float) -> None:
        """Command the robot, within its own limits; a refusal brakes, and is told."""
        try:
            # After a step that took too long, the command's reading is too old to obey.
            if self.robot.now() - now > self.controller.cfg.max_gap:
                command = damping_command(self.controller.robot, self.controller.cfg)
            self.robot.write(clamp(self.robot.description, command, state))
        except Exception as error:
            refusal = f"{REFUSED}: {error}"
            self.controller.trip(refusal, now)
            # The controller tells nothing of a robot that was braked for another reason.
            if self.controller.machine.reason != refusal:
                self._complain("robot", refusal)

    def _look_at_power(self, state: RobotState | None, now: float) -> None:
        """Warn of a battery or motors near their limits, and brake before they fail."""
        self._power.look(state)
        self._complain("power", self._power.warning)
        if self._power.end:
            self.controller.trip(f"{EXHAUSTED}: {self._power.end}", now)

    def _ask(self, device: str, question: Callable[[], Any], otherwise: Any) -> Any:
        """Return a device's answer, or `otherwise` if the device fails, which is told."""
        try:
            return question()
        except Exception as error:
            self._complain(device, f"{type(error).__name__}: {error}")
            return otherwise

    def _complain(self, device: str, why: str) -> None:
        """Tell a device's problem if it is another one than before."""
        if why and self._problems.get(device) != why:
            self.controller.tell(self.robot.now(), device, why)
        self._problems[device] = why


def next_step(robot: RobotDriver, due: float) -> float:
    """Wait for the control step after the one that was due at `due`, s; returns its due time, s.

    Missed steps are left out: two steps in quick succession help no robot.
    """
    due += CONTROL_DT * (math.floor((robot.now() - due) / CONTROL_DT + 0.1) + 1)
    robot.wait(due)
    return due
