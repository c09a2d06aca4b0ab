"""Robot, camera and teleop of one run, made from what the command line asks for."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import TYPE_CHECKING

from renet.bundle import Bundle
from renet.deploy.cameras.base import Camera
from renet.deploy.cameras.faulty import FaultyCamera
from renet.deploy.recording import read_recording
from renet.deploy.robots.base import RobotDriver
from renet.deploy.teleop import CONTROLS, JoystickTeleop, KeyboardTeleop, ScriptedTeleop, Teleop
from renet.errors import RenetError
from renet.faults import parse_fault

if TYPE_CHECKING:
    from renet.deploy.main import DeployCfg

FIRST_IMAGE = 2.0
"""Seconds in which a real camera's first image is waited for."""
GO1 = "Unitree Go1"
"""Robot of the bundles that both drivers take."""


def start_devices(
    cfg: DeployCfg, bundle: Bundle, say: Callable[[str], None], stack: ExitStack
) -> tuple[RobotDriver, Camera | None, Teleop, Callable[[], None]]:
    """Make and start the devices of one run.

    Args:
        cfg: says which. bundle: for them. say: tells the user a line.
        stack: closes them, the robot first, also after half a start.

    Returns:
        Robot, camera (None without one), teleop, and what shows the robot to the user, to be
        called at every control step.

    Raises:
        RenetError: a bundle for another robot or beyond this one's limits, a missing package or
            file, or a device that does not answer.
    """
    robot, show = make_robot(cfg, bundle, say)
    camera = make_camera(cfg, bundle, robot)
    teleop = make_teleop(cfg)
    for device in (teleop, camera, robot):
        stack.callback(getattr(device, "close", lambda: None))
    robot.connect()
    show()  # What moves is told from here on.
    if camera is not None:
        camera.start()
        for _ in range(0 if cfg.simulated else round(FIRST_IMAGE / 0.01)):
            if camera.latest() is not None:
                break
            time.sleep(0.01)
        if cfg.fault:  # Onsets count from its first look, hence from the run's first step.
            faults = [parse_fault(text) for text in cfg.fault]
            camera = FaultyCamera(camera, faults, robot.now, cfg.seed)
    if cfg.teleop != "auto":
        teleop.command(robot.now())  # What was pressed before the robot answered.
    return robot, camera, teleop, show


def make_robot(
    cfg: DeployCfg, bundle: Bundle, say: Callable[[str], None]
) -> tuple[RobotDriver, Callable[[], None]]:
    """The robot, not connected yet, and what shows it to the user."""
    name = bundle.manifest.robot.name
    if name != GO1:
        raise RenetError(f"the bundle drives a {name}, --robot {cfg.robot} is a {GO1}")
    if cfg.robot == "go1":
        from renet.deploy.robots.go1 import Go1Robot
        from renet.deploy.robots.joint_watch import JointWatch

        robot = Go1Robot(host=cfg.robot_host, power_level=cfg.power_level)
        show = JointWatch(robot.read, say).look if cfg.dry_run else lambda: None
    else:
        robot, show = _simulated(cfg, bundle)
    robot.envelope.check(bundle.manifest.robot)
    return robot, show


def _simulated(cfg: DeployCfg, bundle: Bundle) -> tuple[RobotDriver, Callable[[], None]]:
    from renet.deploy.robots.mujoco import MujocoRobot as Simulated
    from renet.deploy.robots.scene import build_scene

    if cfg.robot == "pybullet":
        try:
            from renet.deploy.robots.bullet import BulletRobot as Simulated
        except ModuleNotFoundError as error:
            hint = "pip install 'renet-locomotion[pybullet]'"
            raise RenetError(f"--robot pybullet needs {error.name}: {hint}") from error
    model, ground = build_scene(cfg.terrain, cfg.level, cfg.scene, cfg.seed)
    robot = Simulated(model, bundle.manifest.robot, ground, cfg.live)
    if not cfg.viewer:
        return robot, lambda: None
    from renet.deploy.viewer import BrowserViewer

    return robot, BrowserViewer(model, robot.data, cfg.host).show


def make_camera(cfg: DeployCfg, bundle: Bundle, robot: RobotDriver) -> Camera | None:
    """The camera, healthy and not started yet; None without one."""
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


def make_teleop(cfg: DeployCfg) -> Teleop:
    """The operator's device."""
    if cfg.teleop == "auto":
        return ScriptedTeleop(cfg.speed)
    device = JoystickTeleop if cfg.teleop == "joystick" else KeyboardTeleop
    print(f"{cfg.teleop}: {CONTROLS[cfg.teleop]}")
    if cfg.operator_timeout < math.inf:
        print(f"{cfg.operator_timeout:g} s without a sign of the operator: the robot stands")
    return device(deadman=cfg.operator_timeout)
