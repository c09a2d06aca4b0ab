"""Catalogue of devices for `renet deploy`: `--robot NAME`, `--camera NAME`, `--teleop NAME`.

MuJoCo and the vendors' libraries are imported only by a device that is built, so that nobody needs
those of other devices.
"""

import math
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

from renet.bundle.manifest import CameraSpec, RobotSpec
from renet.deploy.cameras.base import Camera, CameraCfg
from renet.deploy.cameras.realsense import RealSenseCamera, realsense
from renet.deploy.dds.requirements import demand_card, demand_dds, network_cards
from renet.deploy.recording.reader import read_recording
from renet.deploy.recording.replay import ReplayCamera
from renet.deploy.robots.base import DriverCfg, RobotDriver
from renet.deploy.robots.go1.driver import POWER_LEVEL, demand_power_level, go1_robot
from renet.deploy.robots.go2.driver import go2_robot
from renet.deploy.teleop.base import Teleop, TeleopCfg
from renet.deploy.teleop.gamepad import GamepadTeleop
from renet.deploy.teleop.keyboard import KeyboardTeleop
from renet.errors import RenetError, collected, demand_none
from renet.interface import Terrain
from renet.motor_models import IDEAL, find_motors
from renet.robots import GO1, GO2, Robot, find_robot
from renet.server import LOOPBACK


@dataclass(frozen=True)
class SimulationCfg(DriverCfg):
    """The bundle's robot in MuJoCo, in this process."""

    simulated: ClassVar[bool] = True
    camera: ClassVar[str] = "sim"

    terrain: Terrain = "flat"
    """The ground; stairs go down from a summit, stairs_up out of a pit."""
    level: int = 1
    """Level of the terrain, 1 to 10."""
    scene: Path | None = None
    """Ground of your own instead: an MJCF scene (.xml) or a height map (.npy in m, .png)."""
    scene_width: float = 8.0
    """Metres that a height map is wide; of more than 8 it takes a piece, by --seed."""
    scene_height: float = 0.3
    """Metres of white above black in a .png."""
    motors: str = IDEAL
    """Motors of its joints. ideal: MuJoCo's servos. go1: a network of a real Go1's motors. Or a
    file of `renet identify`."""
    real_time: bool = False
    """Pace the simulation to the wall clock, as operators and the viewer always do."""
    viewer: bool = False
    """Show the robot in a browser."""
    host: str = LOOPBACK
    """Address at which the viewer listens; 0.0.0.0: to everybody on the network."""

    @property
    def live(self) -> bool:
        """True if the robot's clock is the wall's."""
        return self.real_time or self.viewer

    def check(self) -> None:
        """Raise RenetError for options that cannot work."""
        if self.scene and self.terrain != "flat":
            raise RenetError("--scene brings its own ground: leave --terrain away")

    def build(self, spec: RobotSpec, live: bool, seed: int, dry_run: bool) -> RobotDriver:
        """Build the scene with the robot in it."""
        from renet.deploy.robots.sim.scene import build_scene

        description = find_robot(spec.name)
        motors = find_motors(self.motors, spec.name)
        model, ground = build_scene(
            self.terrain,
            self.level,
            self.scene,
            seed,
            description,
            self.scene_width,
            self.scene_height,
        )
        # An engine of another package may not take motors.
        options = {} if motors is None else {"motors": motors}
        driver = self.engine()(model, spec, ground, live, **options)
        if self.viewer:
            from renet.deploy.robots.sim.viewer import BrowserViewer

            driver.show = BrowserViewer(model, driver.data, self.host).show
        return driver

    def engine(self) -> Callable[..., Any]:
        """Return the class of the simulated robot, which is called as `MujocoRobot` is.

        It is given `motors` only if they are not ideal.
        """
        from renet.deploy.robots.sim.mujoco import MujocoRobot

        return MujocoRobot


@dataclass(frozen=True)
class Go1Cfg(DriverCfg):
    """A Unitree Go1 in low-level mode."""

    drives: ClassVar[Robot | None] = GO1

    robot_host: str = "192.168.123.10"
    """Address of its motor board."""
    power_level: int = POWER_LEVEL
    """Level of the vendor's own overload guard, 1 (10 % of the motors' power) to 10."""

    def check(self) -> None:
        """Raise RenetError for a power level that the robot does not have."""
        demand_power_level(self.power_level)

    def build(self, spec: RobotSpec, live: bool, seed: int, dry_run: bool) -> RobotDriver:
        """Make the driver of the robot at `robot_host`."""
        return go1_robot(host=self.robot_host, power_level=self.power_level)


@dataclass(frozen=True)
class Go2Cfg(DriverCfg):
    """A Unitree Go2 EDU on a cable."""

    drives: ClassVar[Robot | None] = GO2
    bundle: ClassVar[str | None] = "go2-parkour"

    interface: str = ""
    """Network card that the robot is connected to, such as eth0."""
    domain: int = 0
    """DDS domain of the robot; that of every Go2 is 0."""

    def check(self) -> None:
        """Raise RenetError without an interface, or without Cyclone DDS."""
        # All problems go into one error, so that nobody has to try again for each.
        problems: list[str] = []
        with collected(problems):
            if not self.interface:
                cards = ", ".join(network_cards())
                raise RenetError(f"--robot go2 needs --interface, its network card: one of {cards}")
            demand_card(self.interface)
        with collected(problems):
            demand_dds("the Go2")
        demand_none(problems)

    def build(self, spec: RobotSpec, live: bool, seed: int, dry_run: bool) -> RobotDriver:
        """Make the driver of the robot on `interface`; a dry run leaves the robot's modes alone."""
        return go2_robot(self.interface, self.domain, watch=dry_run)


@dataclass(frozen=True)
class SimCameraCfg(CameraCfg):
    """The bundle's camera on a simulated robot."""

    simulated: ClassVar[bool] = True

    def build(self, spec: CameraSpec, robot: Any, seed: int) -> Camera:
        """Make a camera that looks at the robot's scene."""
        from renet.deploy.cameras.sim import SimCamera

        return SimCamera(robot, spec, seed)


@dataclass(frozen=True)
class RealSenseCfg(CameraCfg):
    """An Intel RealSense."""

    serial: str = ""
    """Serial number of the camera; by default, the only one that is connected."""
    rotate: Literal[0, 180] = 0
    """Degrees by which the camera is turned in its mount: 180 is upside down."""

    def check(self) -> None:
        """Raise RenetError without the vendor's driver."""
        realsense()

    def build(self, spec: CameraSpec, robot: RobotDriver, seed: int) -> Camera:
        """Make a camera whose frames are timed by the robot's clock."""
        return RealSenseCamera(spec, robot.now, serial=self.serial, upside_down=self.rotate == 180)


@dataclass(frozen=True)
class ReplayCfg(CameraCfg):
    """The images of an earlier run."""

    recording: Path | None = None
    """Recording whose images are shown."""

    def check(self) -> None:
        """Raise RenetError without a recording."""
        if self.recording is None:
            raise RenetError("--camera replay needs --recording, whose images it shows")

    def build(self, spec: CameraSpec, robot: RobotDriver, seed: int) -> Camera:
        """Make a camera that shows the recording from its start."""
        assert self.recording is not None
        return ReplayCamera(read_recording(self.recording), robot.now)


@dataclass(frozen=True)
class KeyboardCfg(TeleopCfg):
    """The keys of the terminal."""

    def build(self, deadman: float, simulated: bool) -> Teleop:
        """Take over the keyboard of standard input."""
        return KeyboardTeleop(deadman)


@dataclass(frozen=True)
class GamepadCfg(TeleopCfg):
    """A gamepad."""

    def build(self, deadman: float, simulated: bool) -> Teleop:
        """Open the first gamepad that can steer."""
        return GamepadTeleop(deadman)


@dataclass(frozen=True)
class Ros2Cfg(TeleopCfg):
    """Velocities on a topic of ROS 2; the terminal's keys stand up, stop and quit."""

    silence: ClassVar[float | None] = 0.5

    topic: str = "cmd_vel"
    """Topic of ROS 2 with messages of geometry_msgs/msg/Twist or TwistStamped."""
    ros_domain: int | None = None
    """ROS 2's domain; by default that of the variable ROS_DOMAIN_ID, or 0."""
    ros_interface: str = ""
    """Network card of ROS 2, such as lo; by default, Cyclone DDS chooses."""

    def check(self) -> None:
        """Raise RenetError for a wrong topic or domain, or if Cyclone DDS is not installed."""
        demand_dds("--teleop ros2")
        from renet.deploy.teleop.ros2 import TOPIC, domain_of

        if not TOPIC.fullmatch(self.topic):
            raise RenetError(f"--topic must be a name such as cmd_vel, got {self.topic!r}")
        domain_of(self.ros_domain)

    def build(self, deadman: float, simulated: bool) -> Teleop:
        """Subscribe to the topic, with the keyboard of the terminal, which a real robot needs."""
        from renet.deploy.teleop.ros2 import Ros2Teleop, domain_of

        domain = domain_of(self.ros_domain)
        # A simulated robot can hurt nobody, and may run without a terminal.
        attended = not simulated or (sys.stdin is not None and sys.stdin.isatty())
        keys = KeyboardTeleop(math.inf) if attended else None
        try:
            return Ros2Teleop(
                self.topic, domain, self.ros_interface, deadman, keys=keys, rises=simulated
            )
        except BaseException:
            # Without an operator nobody else gives the terminal back.
            if keys is not None:
                keys.close()
            raise


ROBOTS: dict[str, type[DriverCfg]] = {"mujoco": SimulationCfg, "go1": Go1Cfg, "go2": Go2Cfg}
"""Every robot's options by the name that `--robot` takes. A package adds its own on import."""
CAMERAS: dict[str, type[CameraCfg]] = {
    "sim": SimCameraCfg,
    "realsense": RealSenseCfg,
    "replay": ReplayCfg,
    "none": CameraCfg,
}
"""Every camera's options by the name that `--camera` takes. A package adds its own on import."""
TELEOPS: dict[str, type[TeleopCfg]] = {
    "auto": TeleopCfg,
    "keyboard": KeyboardCfg,
    "joystick": GamepadCfg,
    "ros2": Ros2Cfg,
}
"""Every operator's options by the name that `--teleop` takes. A package adds its own on import."""
