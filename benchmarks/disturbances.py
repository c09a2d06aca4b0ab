"""A simulated Go1 and its camera with everything at random that may go wrong, for the soak."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from hardware_faults import SOON, FailingRobot, Fault, draw
from renet.bundle import Bundle
from renet.deploy.cameras.base import DepthFrame
from renet.deploy.cameras.faulty import FaultyCamera
from renet.deploy.cameras.sim import SimCamera
from renet.deploy.robots.base import JointCommand, RobotState
from renet.deploy.robots.envelope import clamp
from renet.deploy.robots.go1.link import Go1Link
from renet.deploy.safety.machine import ENDED, EXHAUSTED, REFUSED
from renet.errors import RenetError
from renet.faults import FAULTS, Injection
from renet.interface import ACTION_SIZE, CONTROL_DT, control_steps
from vendor_go1 import COLD, Wire

EXCHANGE = 0.01
"""Seconds from one exchange with the robot's motors to the next; a real sender's are 0.002."""
LASTS = 10.0
"""Seconds for which hardware stays out of order where nobody is told of it."""
HEATING = 8.0
"""°C a second by which a motor gets hot."""
COOLING = 4.0
"""°C a second by which it gets cold again, once the operator has put the robot back."""
DISCHARGE = 0.05
"""Charge that a failing battery loses in a second."""
STOPPED = "operator stop"
"""Reason for which a robot that fell is braked."""
OTHERS = ("the state is", "no control tick", REFUSED, EXHAUSTED, ENDED)
"""Beginnings of reasons to brake that say nothing of a failing sensor or motor."""


@dataclass(frozen=True)
class Means:
    """Mean seconds between two disturbances of each kind; inf: never.

    Faults of the camera's catalogue follow each other with gaps of 2 to 8 s.
    """

    push: float = 8.0
    reading_lost: float = 15.0
    reading_late: float = 60.0
    reading_not_finite: float = 150.0
    control_step_late: float = 20.0
    camera_stalls: float = 45.0
    camera_driver_fails: float = 45.0
    hardware: float = 20.0
    """One of `hardware_faults`: a sensor or a motor that freezes, sticks, drifts or dies."""
    damaged_packets: float = 60.0
    """Nine of ten packets have a wrong CRC, for up to 0.3 s."""
    absurd_numbers: float = 60.0
    """Up to four packets with an absurd number, whose CRC is right."""
    wrong_counts: float = 90.0
    """Half of the packets have a wrong count, for up to 0.4 s."""
    no_sign_of_life: float = 60.0
    """The controller's process is silent for up to 0.3 s."""
    motor_mode: float = 240.0
    """A motor leaves its mode."""
    heat: float = 240.0
    """A motor heats up."""
    battery: float = 240.0
    """The battery runs down."""
    second_robot: float = 400.0
    """Another robot answers, too."""
    robot_restarts: float = 600.0
    vendor_driver_fails: float = 900.0
    vendor_guard: float = 900.0
    """The vendor's guard says that the motors draw too much power."""
    program_ends: float = 900.0
    """The operator ends the program, and begins anew."""


@dataclass
class Failure:
    """A fault of the hardware, and what became of it."""

    fault: Fault
    walking: bool
    """True if the robot walked when the fault began."""
    braked: float | None = None
    """Seconds after which the robot was braked, or the operator told of its body; None if nothing
    happened before the part recovered."""
    why: str = ""
    """The first reason that the operator was told."""

    @property
    def outcome(self) -> str:
        """What became of it: told soon or later, not told, a fall, or another reason to brake."""
        if self.braked is None:
            return "not told"
        if self.why == STOPPED:
            return "fell"
        if self.why.startswith(OTHERS):
            return "braked for another reason"
        return "told soon" if self.braked <= SOON + 1e-6 else "told later"


class Body(FailingRobot):
    """A simulated robot of which parts fail, and are mended again."""

    def __init__(self, seed: int, *arguments) -> None:
        super().__init__(None, seed, *arguments)
        self._start = self.data.qpos.copy()
        self._friction = self.model.dof_frictionloss.copy()

    def fail(self, fault: Fault) -> None:
        """Let a part fail from `fault.time` on."""
        self.mend()
        self.fault = fault

    def mend(self) -> None:
        """Let every part work again."""
        self.fault = None
        self._held = None
        self._free_at = 0.0
        self.model.dof_frictionloss[:] = self._friction

    def put_back(self) -> None:
        """Stand on its feet in the middle of the tile."""
        self.data.qpos[:] = self._start
        self.data.qvel[:] = 0.0

    def behind(self) -> float:
        """Seconds by which the simulation is late on the wall clock."""
        return time.monotonic() - self._begun - self.now()


class ShakyRobot:
    """Driver of a simulated Go1 behind the vendor's module, as `RealRobot` drives a real one.

    Its sender lives in this process and on the simulated clock. Keeps what goes wrong, when and how
    often.
    """

    def __init__(
        self, seed: int, body: Body, means: Means, on_command: Callable[[JointCommand], None]
    ) -> None:
        self.body = body
        self.description = body.description
        self.random = np.random.default_rng(seed)
        self.wire = Wire(body, self.random, on_command)
        self.link: Go1Link = self.wire.link()
        self.given: list[tuple[float, str]] = []
        """Time, s, and name of each disturbance."""
        self.failures: list[Failure] = []
        """Faults of the hardware."""
        self.walking = False
        """True while the robot is told to walk."""
        self._means = means
        self._silent = -math.inf
        """Time up to which readings are late, s."""
        self._late: RobotState | None = None
        self._over: dict[str, float] = {}
        """Time at which each attribute of the wire is put right by itself, s."""
        self._hot: int | None = None
        """Motor that heats up."""
        self._empties = False
        """True while the battery runs down."""

    # As a driver.

    def connect(self) -> None:
        """Begin anew, as a program that is started again does; waits for a reading."""
        self.body.connect()
        self.link = self.wire.link()
        until = self.now() + 1.0
        while self.link.state is None and not self.link.problem and self.now() < until:
            self._exchange()
            self.body.wait(self.now() + EXCHANGE)

    def read(self) -> RobotState | None:
        """Return the newest reading, which may be lost, late or not finite."""
        state = self.link.state
        if self.strikes("reading_late"):
            self._silent = self.now() + self.random.uniform(0.02, 0.06)
        if state is None or self.strikes("reading_lost"):
            return None
        if self.strikes("reading_not_finite"):
            return replace(state, joint_velocity=np.full(ACTION_SIZE, np.nan))
        if self._late is None or self.now() >= self._silent:
            self._late = state
        return self._late

    def write(self, command: JointCommand) -> None:
        """Hand a command to the link; raises RenetError once the robot is braked for good."""
        if self.link.problem:
            raise RenetError(self.link.problem)
        self.link.command(clamp(self.description, command), self.now())

    def now(self) -> float:
        """Return the simulated time, s."""
        return self.body.now()

    def wait(self, until: float) -> None:
        """Let time pass, in which anything may go wrong."""
        if self.strikes("push"):
            self.body.data.qvel[:2] += 0.5 * self.random.standard_normal(2)  # m/s
        if self.strikes("control_step_late"):
            until += self.random.uniform(0.0, 0.09)
        self._fail_hardware()
        self._disturb_wire()
        self._change_power()
        self._exchange()
        step = self.body.model.opt.timestep
        while until - self.now() > step / 2:
            self.body.wait(min(self.now() + EXCHANGE, until))
            self._exchange()

    def close(self) -> None:
        """Do nothing: there is nothing to let go of."""

    @property
    def base_position(self) -> np.ndarray:
        """[3] position of the base in the world, m."""
        return self.body.base_position

    # For the operator.

    def repair(self) -> None:
        """Mend every part, change the battery, and let motors cool down."""
        self.body.mend()
        temperature = self.wire.temperature
        self.wire.heal()
        self.wire.temperature = temperature
        self._hot = None
        self._empties = False

    def alarm(self, why: str) -> None:
        """Note that the operator was told why the robot is braked, or what is wrong with it."""
        if self.body.fault is None or not self.failures:
            return
        failure = self.failures[-1]
        if failure.braked is None:
            failure.braked = round(self.now() - failure.fault.time, 2)
            failure.why = why

    # What goes wrong.

    def strikes(self, what: str) -> bool:
        """Draw if something happens now; asked once in a control step."""
        struck = bool(self.random.random() < CONTROL_DT / getattr(self._means, what))
        if struck:
            self.given.append((self.now(), what))
        return struck

    def _exchange(self) -> None:
        """Let the sender exchange with the robot, as `sender.step` does."""
        now = self.now()
        if not self.wire.lifeless:
            self.link.alive(now)
        with self.link.braked_on_failure():
            self.link.exchange(now)

    def _fail_hardware(self) -> None:
        """Let a part fail at random; one of which nobody is told recovers by itself."""
        fault = self.body.fault
        if fault is not None:
            if self.now() > fault.time + LASTS:
                self.body.mend()
            return
        if self.strikes("hardware"):
            drawn = draw(int(self.random.integers(2**31)))
            fault = replace(drawn, time=self.now())
            self.body.fail(fault)
            self.failures.append(Failure(fault, self.walking))

    def _disturb_wire(self) -> None:
        """Garble, lose or mix up packets at random."""
        wire = self.wire
        for attribute, end in list(self._over.items()):
            if self.now() >= end:
                setattr(wire, attribute, False)
                del self._over[attribute]
        self._for_a_while("damaged_packets", "damaged", 0.3)
        self._for_a_while("wrong_counts", "miscounts", 0.4)
        self._for_a_while("no_sign_of_life", "lifeless", 0.3)
        self._for_a_while("second_robot", "stranger", 1.0)
        self._for_a_while("vendor_driver_fails", "broken", 0.1)
        self._for_a_while("vendor_guard", "overloaded", 0.1)
        if self.strikes("absurd_numbers"):
            wire.absurd = int(self.random.integers(1, 5))
        if self.strikes("robot_restarts"):
            wire.restart()
        if self.strikes("motor_mode"):
            wire.modes[self.random.integers(ACTION_SIZE)] = 0

    def _for_a_while(self, what: str, attribute: str, longest: float) -> None:
        """Switch an attribute of the wire on at random, for at most `longest` seconds."""
        if self.strikes(what):
            setattr(self.wire, attribute, True)
            self._over[attribute] = self.now() + self.random.uniform(0.0, longest)

    def _change_power(self) -> None:
        """Heat or cool the motors, and discharge the battery."""
        wire = self.wire
        if self.strikes("heat"):
            self._hot = int(self.random.integers(ACTION_SIZE))
        if self.strikes("battery"):
            self._empties = True
        wire.temperature = np.maximum(wire.temperature - COOLING * CONTROL_DT, COLD)
        if self._hot is not None:
            wire.temperature[self._hot] += (HEATING + COOLING) * CONTROL_DT
        if self._empties:
            wire.charge = max(wire.charge - DISCHARGE * CONTROL_DT, 0.0)


class ShakyCamera:
    """A simulated camera with one fault of the catalogue after the other, that also stalls."""

    busy = False

    def __init__(self, robot: ShakyRobot, bundle: Bundle) -> None:
        self._robot = robot
        self._camera = SimCamera(robot.body, bundle.manifest.camera)
        self._over = -math.inf
        """Time at which another fault is drawn, s."""
        self._stalled = -math.inf
        """Time up to which no image comes, s."""
        self._frame: DepthFrame | None = None

    def start(self) -> None:
        """Begin to stream."""
        self._camera.start()

    def close(self) -> None:
        """Do nothing: there is nothing to let go of."""

    def latest(self) -> DepthFrame | None:
        """Return the newest frame; raises OSError where the driver fails."""
        robot = self._robot
        now = robot.now()
        random = robot.random
        if now >= self._over:
            self._draw(now)
        if robot.strikes("camera_stalls"):
            self._stalled = now + random.uniform(0.1, 3.0)
        if robot.strikes("camera_driver_fails"):
            raise OSError("no device")
        if now >= self._stalled:
            self._frame = self._faulty.latest()
        return self._frame

    def _draw(self, now: float) -> None:
        """Draw the next fault, which begins after a gap."""
        robot = self._robot
        random = robot.random
        fault = str(random.choice(list(FAULTS)))
        severity = int(random.integers(1, 6))
        robot.given.append((now, fault))
        gap = random.uniform(2.0, 8.0)
        lasts = random.uniform(0.5, 8.0)
        injection = Injection.of(fault, severity, control_steps(gap), lasts)
        seed = int(random.integers(2**31))
        self._over = now + gap + lasts
        self._faulty = FaultyCamera(self._camera, [injection], robot.now, seed)
