"""The proprioception o_t from a robot's sensors, scaled as in training."""

from collections.abc import Sequence

import numpy as np

from renet.bundle.manifest import RobotSpec
from renet.deploy.robots.base import RobotState, projected_gravity
from renet.interface import PROPRIOCEPTION

_SCALES = np.concatenate([np.full(term.size, term.scale) for term in PROPRIOCEPTION])
"""Scales of the numbers of o_t, [45]."""


def observe(
    state: RobotState, robot: RobotSpec, command: Sequence[float], last_action: np.ndarray
) -> np.ndarray:
    """Return one robot's o_t, [45] float32.

    Args:
        state: Reading of its sensors.
        robot: Robot of the bundle, from whose default pose positions are measured.
        command: Command of the policy, [3], see `interface.TOLD`.
        last_action: Last action, [12] policy units, clipped as it was carried out.
    """
    terms = {
        "base_angular_velocity": state.angular_velocity,
        "projected_gravity": projected_gravity(state.quaternion),
        "command": command,
        "joint_position": state.joint_position - robot.arrays["default_position"],
        "joint_velocity": state.joint_velocity,
        "last_action": last_action,
    }
    values = np.concatenate([terms[term.name] for term in PROPRIOCEPTION])
    return (_SCALES * values).astype(np.float32)
