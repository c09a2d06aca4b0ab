"""Robot, camera and operator of one run: made from its settings, started and closed."""

import math
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from types import SimpleNamespace
from typing import Any

from renet.bundle import DEFAULT, Bundle, pretrained, read_manifest
from renet.deploy.cameras.base import Camera, CameraCfg
from renet.deploy.cameras.faulty import FaultyCamera
from renet.deploy.cfg import DeployCfg
from renet.deploy.checklist import SLOW, Checklist, count_readings, time_models
from renet.deploy.robots.base import RobotDriver
from renet.deploy.robots.envelope import demand_within
from renet.deploy.robots.real.driver import RealRobot
from renet.deploy.robots.real.lock import claim
from renet.deploy.teleop.base import Teleop, TeleopCfg
from renet.deploy.teleop.scripted import ScriptedTeleop
from renet.errors import RenetError, collected
from renet.interface import Told

CLOSE_TIMEOUT = 5.0
"""Time that a device may take to be closed, s; a robot that sinks takes 3 s."""
_FIRST_IMAGE = 2.0
"""Time that a real camera may take for its first image, s."""


def start_devices(
    cfg: DeployCfg,
    bundle: Bundle,
    say: Callable[[str], None],
    stack: ExitStack,
    checklist: Checklist,
) -> tuple[RobotDriver, Camera | None, Teleop]:
    """Make and start robot, camera and operator of one run.

    Args:
        cfg: Settings of the run.
        bundle: Bundle that will drive the robot.
        say: Function that prints a line for the user.
        stack: Stack that closes the devices, the robot first, also if the start fails halfway.
        checklist: Steps of the start, which a dry run prints.

    Returns:
        The robot, the camera (None without one) and the operator's device.

    Raises:
        RenetError: The bundle is for another robot or beyond this one's limits, a package or file
            is missing, another program drives the robot, or a device does not answer.
    """
    robot = make_robot(cfg, bundle)
    # The sender process of a `RealRobot` holds a lock of its own.
    if not (cfg.robot_cfg.simulated or isinstance(robot, RealRobot)):
        stack.enter_context(claim(f"{cfg.robot} {cfg.robot_cfg.address}".rstrip()))
    camera = cfg.camera_cfg.build(bundle.manifest.camera, robot, cfg.seed)
    teleop = None
    with checklist.step(f"{cfg.teleop} can steer"):
        teleop = make_teleop(cfg, bundle.manifest.told)
    # The stack closes in reverse: the robot first.
    for device in (teleop, camera, robot):
        stack.callback(close_device, device, say)
    answers = False
    with checklist.step(f"{cfg.robot} answers"):
        robot.connect()
        answers = True
    if refused := getattr(robot, "refused", ""):
        say(refused)
    if camera is not None:
        with checklist.step("the camera sends images"):
            _start_camera(camera, cfg.robot_cfg.simulated, checklist.patience)
        # Onsets of faults count from the first look, hence from the run's first step.
        if cfg.fault:
            camera = FaultyCamera(camera, cfg.faults, robot.now, cfg.seed, robot.read)
    if checklist.patience:
        # A simulated robot's readings are always in time, and a silent one sends none to count.
        counted = answers and not cfg.robot_cfg.simulated
        _check_pace(robot if counted else None, bundle, checklist)
    checklist.finish()
    # Raised before, if there is none.
    assert teleop is not None
    teleop.drain(robot.now())
    return robot, camera, teleop


def missing_devices(cfg: DeployCfg, say: Callable[[str], None]) -> list[str]:
    """Try the operator's device and a real camera alone, without a robot.

    A dry run whose settings fail names with them whatever else is missing.

    Returns:
        A line for each problem. Those of the settings (`DeployCfg.problems`) are left out.
    """
    problems: list[str] = []
    with ExitStack() as stack:
        manifest = read_manifest(pretrained(cfg.robot_cfg.bundle or DEFAULT))
        if _complete(cfg.teleop_cfg):
            with collected(problems):
                stack.callback(close_device, make_teleop(cfg, manifest.told), say)
        if not cfg.camera_cfg.simulated and _complete(cfg.camera_cfg):
            # In place of the robot, whose clock is all that a camera needs.
            clock: Any = SimpleNamespace(now=time.monotonic)
            with collected(problems):
                camera = cfg.camera_cfg.build(manifest.camera, clock, cfg.seed)
                stack.callback(close_device, camera, say)
                if camera is not None:
                    _start_camera(camera, simulated=False, demanded=True)
    return problems


def _complete(part: CameraCfg | TeleopCfg) -> bool:
    """Return True if a device's options pass their own check."""
    try:
        part.check()
    except RenetError:
        return False
    return True


def close_device(device: Any, say: Callable[[str], None]) -> None:
    """Close a device if it can be closed; one that fails or hangs is told, and left behind."""
    problem = [f"does not close within {CLOSE_TIMEOUT:g} s"]

    def close() -> None:
        try:
            getattr(device, "close", lambda: None)()
        except Exception as error:
            problem[0] = f"cannot be closed: {error}"
        else:
            problem.clear()

    thread = threading.Thread(target=close, daemon=True)
    thread.start()
    thread.join(CLOSE_TIMEOUT)
    if problem:
        say(f"{type(device).__name__} {problem[0]}")


def _check_pace(robot: RobotDriver | None, bundle: Bundle, checklist: Checklist) -> None:
    """Check that models and a robot's readings keep up with the control loop, as further steps."""
    with checklist.step("the models are quick enough", SLOW) as remarks:
        remarks.append(time_models(bundle))
    if robot is not None:
        with checklist.step("the robot's readings come in time") as remarks:
            remarks.append(count_readings(robot))


def _start_camera(camera: Camera, simulated: bool, demanded: bool) -> None:
    """Start a camera, and wait for the first image of a real one.

    Raises:
        RenetError: The camera fails, or no image comes although it is `demanded`. Otherwise a run
            begins without an image.
    """
    camera.start()
    if simulated:
        return
    for _ in range(round(_FIRST_IMAGE / 0.01)):
        if camera.latest() is not None:
            return
        time.sleep(0.01)
    if demanded:
        raise RenetError(
            f"no image within {_FIRST_IMAGE:g} s: check the cable, a USB 3 one, and its plugs"
        )


def make_robot(cfg: DeployCfg, bundle: Bundle) -> RobotDriver:
    """Make the robot, without connecting it; raises RenetError for a bundle that it cannot take."""
    spec = bundle.manifest.robot
    robot = cfg.robot_cfg.build(spec, cfg.live, cfg.seed, cfg.dry_run)
    demand_within(robot.description, spec)
    return robot


def make_teleop(cfg: DeployCfg, told: Told) -> Teleop:
    """Open the operator's device, and print how to steer a policy with it, by what it is told."""
    if cfg.teleop == "auto":
        return ScriptedTeleop(cfg.speed)
    teleop = cfg.teleop_cfg.build(cfg.operator_timeout, cfg.robot_cfg.simulated)
    controls = teleop.controls
    if told == "heading":
        controls = getattr(teleop, "controls_ahead", controls)
    print(f"{cfg.teleop}: {controls}")
    if cfg.operator_timeout < math.inf:
        print(f"{cfg.operator_timeout:g} s without a sign of the operator: the robot stands")
    return teleop
