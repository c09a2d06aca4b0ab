"""Robot, camera and teleop of one run, made from what the command line asks for."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from renet.deploy.bundle import Bundle
from renet.deploy.cameras.base import Camera
from renet.deploy.cameras.faulty import FaultyCamera
from renet.deploy.recording import read_recording
from renet.deploy.robots.base import RobotDriver
from renet.deploy.teleop import ScriptedTeleop, Teleop
from renet.errors import RenetError
from renet.faults import parse_fault

if TYPE_CHECKING:
    from renet.deploy.main import DeployCfg

FIRST_IMAGE = 2.0
"""Seconds in which a real camera's first image is waited for."""
GO1 = "Unitree Go1"
"""Robot of the bundles that both drivers take."""


@dataclass
class Devices:
    """The devices of one run; `start` and `close` go for all of them."""

    robot: RobotDriver
    camera: Camera | None
    teleop: Teleop
    truth: Callable[[], np.ndarray | None] = lambda: None
    """Where the base is, [3] m, if the robot is simulated."""
    wait_for_image: bool = False
    """Whether `start` gives the camera time for its first image."""
    show: Callable[[], None] = lambda: None
    """Shows the simulation; called at every control step."""

    def start(self) -> None:
        """Connect to the robot, start the camera."""
        self.robot.connect()
        self.show()  # What moves is told from here on.
        if self.camera is not None:
            self.camera.start()
        for _ in range(round(FIRST_IMAGE / 0.01) if self.wait_for_image else 0):
            if self.camera is None or self.camera.latest() is not None:
                return
            time.sleep(0.01)

    def close(self) -> None:
        """Let go of everything, the robot first."""
        with ExitStack() as stack:
            stack.callback(getattr(self.teleop, "close", lambda: None))
            if self.camera is not None:
                stack.callback(self.camera.close)
            stack.callback(self.robot.close)


def make_devices(cfg: DeployCfg, bundle: Bundle, say: Callable[[str], None]) -> Devices:
    """Set up, without touching a device yet except the operator's; `say` tells the user a line.

    Raises:
        RenetError: a bundle for another robot or beyond this one's limits, or a missing package
            or file.
    """
    name = bundle.manifest.robot.name
    if name != GO1:
        raise RenetError(f"the bundle drives a {name}, --robot {cfg.robot} is a {GO1}")
    robot, truth, show = _robot(cfg, bundle, say)
    robot.envelope.check(bundle.manifest.robot)
    camera = _camera(cfg, bundle, robot)
    if cfg.fault and camera is not None:
        faults = [parse_fault(text) for text in cfg.fault]
        camera = FaultyCamera(camera, faults, robot.now, cfg.seed)
    return Devices(robot, camera, _teleop(cfg), truth, not cfg.simulated, show)


def _robot(
    cfg: DeployCfg, bundle: Bundle, say: Callable[[str], None]
) -> tuple[RobotDriver, Any, Callable[[], None]]:
    if cfg.robot == "go1":
        from renet.deploy.robots.go1 import Go1Robot
        from renet.deploy.robots.joint_watch import JointWatch

        go1 = Go1Robot(host=cfg.robot_host, power_level=cfg.power_level)
        return go1, lambda: None, JointWatch(go1.read, say).look if cfg.dry_run else lambda: None
    try:
        from renet.deploy.robots.scene import build_scene

        if cfg.robot == "pybullet":
            from renet.deploy.robots.bullet import BulletRobot as Simulated
        else:
            from renet.deploy.robots.mujoco import MujocoRobot as Simulated
    except ModuleNotFoundError as error:
        extra = "pybullet" if error.name == "pybullet" else "sim"
        raise RenetError(
            f"--robot {cfg.robot} needs {error.name}: pip install 'renet-locomotion[{extra}]'"
        ) from error
    model, ground = build_scene(cfg.terrain, cfg.level, cfg.scene, cfg.seed)
    robot = Simulated(model, bundle.manifest.robot, ground, cfg.live)
    show: Callable[[], None] = lambda: None  # noqa: E731
    if cfg.viewer:
        from renet.deploy.viewer import BrowserViewer

        show = BrowserViewer(model, robot.data, cfg.host).show
    return robot, lambda: robot.base_position, show


def _camera(cfg: DeployCfg, bundle: Bundle, robot: RobotDriver) -> Camera | None:
    spec, kind = bundle.manifest.camera, cfg.camera
    if kind == "auto":
        kind = "sim" if cfg.simulated else "realsense"
    if kind == "sim":
        from renet.deploy.cameras.sim import SimCamera

        return SimCamera(robot, spec, cfg.seed)  # type: ignore[arg-type]
    if kind == "realsense":
        from renet.deploy.cameras.realsense import RealSenseCamera

        return RealSenseCamera(spec, robot.now, serial=cfg.serial)
    if kind == "replay":
        from renet.deploy.replay import ReplayCamera

        assert cfg.recording is not None
        return ReplayCamera(read_recording(cfg.recording), robot.now)
    return None


def _teleop(cfg: DeployCfg) -> Teleop:
    if cfg.teleop == "auto":
        return ScriptedTeleop(cfg.speed)
    from renet.deploy.teleop import KEYS, JoystickTeleop, KeyboardTeleop

    if cfg.teleop == "joystick":
        return JoystickTeleop(deadman=cfg.operator_timeout)
    print(f"keys: {KEYS}")
    if cfg.operator_timeout < math.inf:
        print(f"{cfg.operator_timeout:g} s without any key: the robot stands")
    return KeyboardTeleop(deadman=cfg.operator_timeout)
