"""All checks of a robot's body, which the controller asks at every control step."""

import numpy as np

from renet.bundle.manifest import RobotSpec
from renet.deploy.robots.base import JointCommand, RobotState
from renet.deploy.safety.limits import SafetyCfg
from renet.deploy.watch.blocking import Blocking
from renet.deploy.watch.freezing import Freezing
from renet.deploy.watch.intake import Intake
from renet.deploy.watch.legs import Legs
from renet.deploy.watch.motors import MotorWatch
from renet.deploy.watch.speed import SpeedWatch
from renet.errors import RenetError
from renet.robots import robots


class BodyWatch:
    """Checks a robot's readings, and compares its commands with its motion.

    Motors, joints and speed are compared while the robot walks. The check of the speed needs a
    description of its legs.
    """

    def __init__(self, robot: RobotSpec, cfg: SafetyCfg, limp: bool = False) -> None:
        """Watch one robot; a `limp` one is never commanded, so that its sensors may stand still."""
        self._cfg = cfg
        self._limp = limp
        self._intake = Intake(robot, cfg)
        self._freezing = Freezing()
        torque = robot.arrays["torque_limit"]
        self._motors = MotorWatch(torque, _speeds(robot), cfg.least_torque)
        self._blocking = Blocking()
        self._speed = _speed_watch(robot)
        self._target: np.ndarray | None = None
        self._powered = False
        self._walking = False
        self._estimate = np.zeros(3)
        """Velocity of the base that the policy estimates, [3] m/s, base frame."""
        self._problem = ""
        self.warning = ""
        """First warning of the walk for the operator; empty while there is none."""

    @property
    def newest(self) -> RobotState | None:
        """Newest reading that passed the checks; None before the first."""
        return self._intake.newest

    def offer(self, raw: RobotState | None, now: float) -> None:
        """Check the newest reading at `now`, in seconds on the robot's clock."""
        state = self._intake.offer(raw, now)
        if state is None:
            return
        self._problem = self._freezing.problem(state, self._powered, self._target)
        # Motors and speed are judged by accepted readings alone.
        if state is not self.newest or self._target is None:
            return
        self._problem = self._problem or self._motors.problem(state)
        self.warning = self.warning or self._blocking.warning(state, self._target)
        if self._speed is not None:
            self._problem = self._problem or self._speed.problem(state, self._estimate)

    def problem(self, now: float) -> str:
        """Return why the robot must not move at `now`, s; empty if it may."""
        return self._intake.problem(now) or self._problem

    def told(self, command: JointCommand, walking: bool, estimate: np.ndarray) -> None:
        """Keep the command that the robot is given now.

        Args:
            command: Command of its joint servos.
            walking: True while it walks, so that all its joints move.
            estimate: Velocity of the base that the policy estimates, [3] m/s, base frame.
        """
        # A least torque of 0 switches off all that is watched while the robot walks.
        followed = walking and self._cfg.least_torque > 0.0
        # A walk begins: what motors gave while the robot stood up says nothing of it.
        if followed and not self._walking:
            self._motors.start_over()
            self._blocking.start_over()
            self.warning = ""
            if self._speed is not None:
                self._speed.start_over()
        self._powered = not self._limp and bool(command.stiffness.any())
        self._walking = followed
        self._target = command.position if followed else None
        self._estimate = estimate
        self._motors.told(command)


def _speeds(robot: RobotSpec) -> np.ndarray:
    """Return the speeds beyond which drivers only brake a joint, [12] rad/s; inf if unknown."""
    if robot.name not in robots():
        return np.full(len(robot.joints), np.inf)
    return robots()[robot.name].velocity


def _speed_watch(robot: RobotSpec) -> SpeedWatch | None:
    """Make the check of the speed; None for a robot without a description of its legs."""
    try:
        return SpeedWatch(Legs(robots()[robot.name]))
    except (KeyError, RenetError):
        return None
