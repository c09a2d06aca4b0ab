"""Robot, camera and operator of one run, made from its settings and started."""

import math
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

from renet.bundle import Bundle
from renet.deploy.cameras.base import Camera
from renet.deploy.cameras.faulty import FaultyCamera
from renet.deploy.cfg import DeployCfg
from renet.deploy.checklist import Checklist, count_readings, time_models
from renet.deploy.robots.driver import RobotDriver
from renet.deploy.robots.envelope import demand_within
from renet.deploy.robots.real.driver import RealRobot
from renet.deploy.robots.real.lock import claim
from renet.deploy.teleop import ScriptedTeleop, Teleop
from renet.errors import RenetError

CLOSING = 5.0
"""Seconds that a device may take to be closed; a robot that sinks takes three."""
FIRST_IMAGE = 2.0
"""Seconds in which a real camera's first image is waited for."""


def start_devices(
    cfg: DeployCfg,
    bundle: Bundle,
    say: Callable[[str], None],
    stack: ExitStack,
    checklist: Checklist,
) -> tuple[RobotDriver, Camera | None, Teleop]:
    """Make and start the robot, the camera (None without one) and the operator of one run.

    `stack` closes them, the robot first, also after half a start; `say` tells the user a line. The
    `checklist` of a dry run holds all that a run needs.

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
        stack.callback(close_device, device, say)
    with checklist.step(f"{cfg.robot} answers"):
        robot.connect()
    if refused := getattr(robot, "refused", ""):
        say(refused)
    if camera is not None:
        with checklist.step("the camera sends images"):
            _start_camera(camera, cfg.driver.simulated, checklist.patience)
        if cfg.fault:  # Onsets count from its first look, hence from the run's first step.
            camera = FaultyCamera(camera, cfg.faults, robot.now, cfg.seed)
    if checklist.patience:
        _check_pace(robot, bundle, cfg.driver.simulated, checklist)
    checklist.finish()
    teleop.drain(robot.now())
    return robot, camera, teleop


def close_device(device: Any, say: Callable[[str], None]) -> None:
    """Close a device, if it can be: one that fails or hangs costs neither score nor program."""
    problem = [f"does not close within {CLOSING:g} s"]

    def close() -> None:
        try:
            getattr(device, "close", lambda: None)()
        except Exception as error:
            problem[0] = f"cannot be closed: {error}"
        else:
            problem.clear()

    thread = threading.Thread(target=close, daemon=True)
    thread.start()
    thread.join(CLOSING)
    if problem:
        say(f"{type(device).__name__} {problem[0]}")


def _check_pace(robot: RobotDriver, bundle: Bundle, simulated: bool, checklist: Checklist) -> None:
    """Whether models and readings keep up with the control loop."""
    with checklist.step("the models are quick enough") as remarks:
        remarks.append(time_models(bundle))
    # One that does not answer sends nothing.
    if not (simulated or checklist.failures):
        with checklist.step("the robot's readings come in time") as remarks:
            remarks.append(count_readings(robot))


def _start_camera(camera: Camera, simulated: bool, demanded: bool) -> None:
    """Start a camera and wait a little for a real one's first image.

    Raises RenetError for one that fails, or whose image is `demanded` and does not come: a run
    begins without.
    """
    camera.start()
    if simulated:
        return
    for _ in range(round(FIRST_IMAGE / 0.01)):
        if camera.latest() is not None:
            return
        time.sleep(0.01)
    if demanded:
        raise RenetError(
            f"no image within {FIRST_IMAGE:g} s: check the cable, a USB 3 one, and its plugs"
        )


def make_robot(cfg: DeployCfg, bundle: Bundle) -> RobotDriver:
    """The robot, not connected yet; raises RenetError for a bundle that it cannot take."""
    spec = bundle.manifest.robot
    robot = cfg.driver.build(spec, cfg.live, cfg.seed, cfg.dry_run)
    demand_within(robot.description, spec)
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
