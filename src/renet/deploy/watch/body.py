"""A robot's readings and motors, watched together: what the controller asks at every step."""

import numpy as np

from renet.bundle.manifest import RobotSpec
from renet.deploy.robots.base import JointCommand, RobotState
from renet.deploy.safety.limits import SafetyCfg
from renet.deploy.watch.freezing import Freezing
from renet.deploy.watch.intake import Intake
from renet.deploy.watch.legs import Legs
from renet.deploy.watch.motors import MotorWatch
from renet.deploy.watch.speed import SpeedWatch
from renet.errors import RenetError
from renet.robots import robots


class BodyWatch:
    """Believes a robot's readings or not, and compares what it is told with what it does.

    Motors and speed are compared while the robot walks. Speed needs a description of its legs.
    """

    def __init__(self, robot: RobotSpec, cfg: SafetyCfg) -> None:
        self._cfg = cfg
        self._intake = Intake(robot, cfg)
        self._freezing = Freezing()
        torque = robot.arrays["torque_limit"]
        self._motors = MotorWatch(torque, _speeds(robot), cfg.least_torque)
        self._speed = _speed_watch(robot)
        self._target: np.ndarray | None = None
        self._powered = self._walking = False
        self._estimate = np.zeros(3)
        self._problem = ""

    @property
    def newest(self) -> RobotState | None:
        """The newest reading that is believed; None before the first."""
        return self._intake.newest

    def offer(self, raw: RobotState | None, now: float) -> None:
        """Take in the newest reading at `now`, in seconds on the robot's clock."""
        state = self._intake.offer(raw, now)
        if state is None:
            return
        self._problem = self._freezing.problem(state, self._powered, self._target)
        if state is not self.newest or not self._walking:
            return
        self._problem = self._problem or self._motors.problem(state)
        if self._speed is not None:
            self._problem = self._problem or self._speed.problem(state, self._estimate)

    def problem(self, now: float) -> str:
        """Why the robot must not move at `now`, s; empty if it may."""
        return self._intake.problem(now) or self._problem

    def told(self, command: JointCommand, walking: bool, estimate: np.ndarray) -> None:
        """Keep what the robot is told now, and the velocity [3] m/s that its policy believes in.

        `walking` says whether it walks, so that all its joints move.
        """
        followed = walking and self._cfg.least_torque > 0.0
        if followed and not self._walking:
            self._motors.start_over()
            if self._speed is not None:
                self._speed.start_over()
        self._powered = bool(command.stiffness.any())
        self._walking = followed
        self._target = command.position if followed else None
        self._estimate = estimate
        self._motors.told(command)


def _speeds(robot: RobotSpec) -> np.ndarray:
    """[12] rad/s, beyond which a driver only brakes a joint; infinite where nobody knows."""
    if robot.name not in robots():
        return np.full(len(robot.joints), np.inf)
    return robots()[robot.name].velocity


def _speed_watch(robot: RobotSpec) -> SpeedWatch | None:
    """What compares the legs' speed, for robots whose legs are known."""
    try:
        return SpeedWatch(Legs(robots()[robot.name]))
    except (KeyError, RenetError):
        return None
