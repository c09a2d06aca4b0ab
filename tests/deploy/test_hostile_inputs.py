"""The controller against inputs that nobody should give it."""

import math
from dataclasses import replace

import numpy as np

from renet.deploy.controller import Controller
from renet.deploy.safety.limits import SafetyCfg
from renet.deploy.safety.machine import Mode
from renet.deploy.teleop import TeleopCommand

from .fakes import GO, STANDING, frame, state


def hostile(random: np.random.Generator, now: float):
    """Inputs of which about half are fit to walk with."""

    def one_of(*values):
        return values[random.integers(len(values))]

    def spoilt(value):
        size = np.size(value)
        noise, letters = random.normal(size=size), np.array(["a"] * size)
        numbers = [np.full(size, np.nan), np.full(size, np.inf), 1e30 * noise, 10.0 * noise]
        shapes = [np.zeros(0), np.zeros((3, 5)), np.zeros(100_000), [[1.0], [2.0, 3.0]]]
        return one_of(*numbers, *shapes, None, "?", letters)

    reading = state(now, joint_position=STANDING + 0.08 * random.normal(size=12))
    picture, teleop = frame(int(random.integers(1000)), now), GO
    dice = random.random()
    if dice < 0.12:
        name = one_of(*list(vars(reading))[1:])
        reading = replace(reading, **{name: spoilt(getattr(reading, name))})
    elif dice < 0.15:
        reading = replace(reading, time=one_of(now - 1, now + 1, math.nan, -math.inf, None, "x"))
    elif dice < 0.18:
        reading = one_of(None, None, 7)
    elif dice < 0.25:
        picture = replace(picture, image=spoilt(picture.image))
    elif dice < 0.30:
        field, value = one_of(("time", math.inf), ("number", "x"), ("invalid", math.nan))
        picture = replace(picture, **{field: value})
    elif dice < 0.33:
        picture = one_of(None, 5, "frame")
    elif dice < 0.36:
        fast, endless = {"speed": math.nan}, {"speed": 1e300, "turn": -1e300}
        teleop = one_of(None, *(TeleopCommand(**w) for w in (fast, {"turn": math.inf}, endless)))
    return reading, picture, teleop


def test_10_000_hostile_inputs_never_raise_and_never_leave_the_limits(bundle):
    random, now, walked = np.random.default_rng(0), 0.0, 0
    controller = Controller(bundle, SafetyCfg(stand_up_seconds=0.02))
    robot = controller.robot
    for _ in range(10_000):
        jump = random.random()
        now += 0.02 if jump < 0.99 else random.choice([0.0, -0.05, 0.3, 5.0])
        reading, picture, teleop = hostile(random, now)
        damped = controller.decision.mode is Mode.DAMPING
        if damped and teleop is GO:
            teleop = TeleopCommand(speed=0.5, arm=bool(random.random() < 0.5))
        clock = math.nan if random.random() < 0.002 else now
        command = controller.tick(reading, picture, teleop, clock)
        assert np.isfinite(command.position).all()
        assert ((command.position >= robot.lower) & (command.position <= robot.upper)).all()
        assert ((command.stiffness >= 0) & (command.stiffness <= robot.stiffness)).all()
        assert ((command.damping >= 0) & (command.damping <= 3.0)).all()
        if controller.decision.mode is Mode.DAMPING:
            assert (command.stiffness == 0).all()
        else:
            newest = controller._newest
            torque = command.stiffness * (command.position - newest.joint_position)
            torque -= command.damping * newest.joint_velocity
            assert (np.abs(torque) <= np.array(robot.torque_limit) + 1e-6).all()
            walked += controller.decision.mode is Mode.WALKING
    assert walked > 500, "the abuse must reach the walking controller"
