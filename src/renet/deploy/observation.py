"""The proprioception o_t from a robot's sensors, scaled as in training."""

from collections.abc import Sequence

import numpy as np

from renet.bundle.manifest import RobotSpec
from renet.deploy.robots.base import RobotState, projected_gravity
from renet.interface import PROPRIOCEPTION

SCALES = np.concatenate([np.full(term.size, term.scale) for term in PROPRIOCEPTION])


def observe(
    state: RobotState, robot: RobotSpec, command: Sequence[float], last_action: np.ndarray
) -> np.ndarray:
    """One robot's o_t, [45] float32.

    Args:
        state: sensors. robot: whose default pose positions are measured from.
        command: [3] where the policy is told to go, in the form of its `interface.TOLD`.
        last_action: [12] policy units, as clipped before it was carried out.
    """
    terms = {
        "base_angular_velocity": state.angular_velocity,
        "projected_gravity": projected_gravity(state.quaternion),
        "command": command,
        "joint_position": state.joint_position - robot.arrays["default_position"],
        "joint_velocity": state.joint_velocity,
        "last_action": last_action,
    }
    return (SCALES * np.concatenate([terms[t.name] for t in PROPRIOCEPTION])).astype(np.float32)
