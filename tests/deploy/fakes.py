"""Healthy readings and frames to spoil."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from renet.deploy.cameras.base import DepthFrame
from renet.deploy.robots.base import RobotState
from renet.vocabulary import CONTROL_DT

STANDING = np.tile([0.1, 0.9, -1.8, -0.1, 0.9, -1.8], 2)


def state(time: float = 0.0, **changes) -> RobotState:
    standing = RobotState(
        time=time,
        joint_position=STANDING.copy(),
        joint_velocity=np.zeros(12),
        joint_torque=np.zeros(12),
        quaternion=np.array([1.0, 0, 0, 0]),
        angular_velocity=np.zeros(3),
    )
    return replace(standing, **changes)


def frame(number: int, time: float, seed: int = 0) -> DepthFrame:
    random = np.random.default_rng([seed, number])
    slope = np.linspace(0.9, 0.3, 48)[:, None]
    image = np.clip(slope + 0.03 * random.normal(size=(48, 64)), 0.0, 1.0)
    return DepthFrame(image, number, time)


def time_of(step: int) -> float:
    return round(step * CONTROL_DT, 6)
