"""The proprioception o_t from a robot's sensors, scaled as in training."""

import numpy as np

from renet.deploy.bundle.manifest import RobotSpec
from renet.deploy.robots.base import RobotState
from renet.interface import PROPRIOCEPTION


def observe(
    state: RobotState, robot: RobotSpec, speed: float, yaw: float, last_action: np.ndarray
) -> np.ndarray:
    """One robot's o_t, [45] float32.

    Args:
        state: sensors. robot: whose default pose positions are measured from.
        speed: commanded c_x, m/s. yaw: commanded c_yaw, rad, world frame.
        last_action: [12] policy units, as clipped before it was carried out.
    """
    error = yaw - heading(state.quaternion)
    terms = {
        "base_angular_velocity": state.angular_velocity,
        "projected_gravity": projected_gravity(state.quaternion),
        "command": (speed, np.sin(error), np.cos(error)),
        "joint_position": np.asarray(state.joint_position) - robot.default_position,
        "joint_velocity": state.joint_velocity,
        "last_action": last_action,
    }
    blocks = [term.scale * np.asarray(terms[term.name], float) for term in PROPRIOCEPTION]
    return np.concatenate(blocks).astype(np.float32)


def projected_gravity(quaternion: np.ndarray) -> np.ndarray:
    """Unit vector of gravity in the base frame, [3], from base-to-world (w, x, y, z)."""
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    return -np.array([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)])


def heading(quaternion: np.ndarray) -> float:
    """Yaw of the base, rad: direction of its x axis seen from above."""
    w, x, y, z = quaternion
    return float(np.arctan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z))
