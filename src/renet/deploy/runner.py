"""The 50 Hz loop around the controller: read, decide, write, log, wait.

Whatever a device does, the loop goes on: a robot that cannot be read is damped by the controller,
a camera that fails costs vision.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np

from renet.deploy.cameras.base import Camera, DepthFrame
from renet.deploy.controller import Controller
from renet.deploy.flight_log import FlightLog
from renet.deploy.operator import Operator, Request
from renet.deploy.robots.base import JointCommand, Robot, RobotState, next_step

BRAKING = 25
"""Control steps of braking with which every flight ends (0.5 s)."""
REFUSED = "the robot takes no commands"
"""Why a robot is damped whose driver fails."""


def fly(
    robot: Robot,
    camera: Camera | None,
    operator: Operator,
    controller: Controller,
    log: FlightLog | None = None,
    *,
    done: Callable[[], bool] = lambda: False,
    on_step: Callable[[JointCommand], None] = lambda command: None,
    truth: Callable[[], np.ndarray | None] = lambda: None,
    dry_run: bool = False,
) -> None:
    """Drive a robot until `done`, then brake.

    Args:
        robot: connected. camera: started; None without. operator: whose wishes count.
        controller: decides. log: of the flight. done: asked at every control step.
        on_step: told every command. truth: the base's position [3] m, if anyone knows it.
        dry_run: never write to the robot.
    """
    due, braking = robot.now(), 0
    complaints: dict[str, str] = {}

    def complain(device: str, why: str) -> None:
        """Tell what a device has to say when it says something else than before."""
        if why and complaints.get(device) != why:
            controller.tell(robot.now(), device, why)
        complaints[device] = why

    while braking < BRAKING:
        ending = braking > 0 or done()
        braking += ending
        now = robot.now()
        if ending:
            controller.trip("the flight ends", now)
        state, frame, request = _inputs(robot, camera, operator, now, complain)
        if ending:
            request = Request(stop=True)  # Also so that a replay of the log brakes here.
        begun = time.perf_counter()
        command = controller.tick(state, frame, request, now)
        compute_ms = 1000.0 * (time.perf_counter() - begun)
        if not dry_run:
            _write(robot, command, controller, now)
        if log is not None:
            log.append(state, frame, request, now, controller.decision, compute_ms, truth())
        with suppress(Exception):  # A closed terminal must not end a flight.
            on_step(command)
        due = next_step(robot, due)


def _inputs(
    robot: Robot,
    camera: Camera | None,
    operator: Operator,
    now: float,
    complain: Callable[[str, str], None],
) -> tuple[RobotState | None, DepthFrame | None, Request]:
    """What the devices say; one that fails says nothing, an operator that fails says stop."""

    def ask(device: str, question: Callable[[], Any], otherwise: Any) -> Any:
        try:
            return question()
        except Exception as error:
            complain(device, f"{type(error).__name__}: {error}")
            return otherwise

    state = ask("robot", robot.read, None)
    frame = None if camera is None else ask("camera", camera.latest, None)
    complain("camera", getattr(camera, "problem", ""))
    request = ask("operator", lambda: operator.request(now), Request(stop=True))
    return state, frame, request


def _write(robot: Robot, command: JointCommand, controller: Controller, now: float) -> None:
    try:
        robot.write(command)
    except Exception as error:
        controller.trip(f"{REFUSED}: {error}", now)
