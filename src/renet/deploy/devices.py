"""Robot, camera and operator of one run, made from its settings and started."""

import math
import time
from collections.abc import Callable
from contextlib import ExitStack

from renet.bundle import Bundle
from renet.deploy.cameras.base import Camera
from renet.deploy.cameras.faulty import FaultyCamera
from renet.deploy.cfg import DeployCfg
from renet.deploy.robots.driver import RobotDriver
from renet.deploy.robots.real.driver import RealRobot
from renet.deploy.robots.real.lock import claim
from renet.deploy.teleop import ScriptedTeleop, Teleop
from renet.errors import RenetError

FIRST_IMAGE = 2.0
"""Seconds in which a real camera's first image is waited for."""


def start_devices(
    cfg: DeployCfg, bundle: Bundle, say: Callable[[str], None], stack: ExitStack
) -> tuple[RobotDriver, Camera | None, Teleop]:
    """Make and start the robot, the camera (None without one) and the operator of one run.

    `stack` closes them, the robot first, also after half a start; `say` tells the user a line.

    Raises:
        RenetError: a bundle for another robot or beyond this one's limits, a missing package or
            file, a robot that another program drives, or a device that does not answer.
    """
    robot = make_robot(cfg, bundle)
    if not (cfg.driver.simulated or isinstance(robot, RealRobot)):  # Its sender holds a lock.
        stack.enter_context(claim(f"{cfg.robot} {cfg.driver.address}".rstrip()))
    camera = cfg.lens.build(bundle.manifest.camera, robot, cfg.seed)
    teleop = make_teleop(cfg)
    for device in (teleop, camera, robot):
        stack.callback(getattr(device, "close", lambda: None))
    robot.connect()
    if refused := getattr(robot, "refused", ""):
        say(refused)
    if camera is not None:
        camera.start()
        for _ in range(0 if cfg.driver.simulated else round(FIRST_IMAGE / 0.01)):
            if camera.latest() is not None:
                break
            time.sleep(0.01)
        if cfg.fault:  # Onsets count from its first look, hence from the run's first step.
            camera = FaultyCamera(camera, cfg.faults, robot.now, cfg.seed)
    teleop.drain(robot.now())
    return robot, camera, teleop


def make_robot(cfg: DeployCfg, bundle: Bundle) -> RobotDriver:
    """The robot, not connected yet; raises RenetError for a bundle that it cannot take."""
    spec, drives = bundle.manifest.robot, cfg.driver.drives
    if drives is not None and spec.name != drives.name:
        raise RenetError(f"the bundle drives a {spec.name}, --robot {cfg.robot} is a {drives.name}")
    robot = cfg.driver.build(spec, cfg.live, cfg.seed, cfg.dry_run)
    robot.envelope.check(spec)
    return robot


def make_teleop(cfg: DeployCfg) -> Teleop:
    """The operator's device."""
    if cfg.teleop == "auto":
        return ScriptedTeleop(cfg.speed)
    teleop = cfg.operator.build(cfg.operator_timeout, cfg.driver.simulated)
    print(f"{cfg.teleop}: {teleop.controls}")
    if cfg.operator_timeout < math.inf:
        print(f"{cfg.operator_timeout:g} s without a sign of the operator: the robot stands")
    return teleop
