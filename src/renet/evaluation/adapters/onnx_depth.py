"""Any model of (observation [N, 45], depth [N, 48, 64]) that gives actions [N, 12].

The observation is renet's own (`renet.interface.PROPRIOCEPTION`), the depth is divided by its range
of 2 m, and actions are 0.25 rad of joint target from the Go1's default pose. For policies that were
trained in renet's tasks, or beside them.
"""

import numpy as np

from renet.bundle import pretrained, read_manifest
from renet.evaluation.adapters import base
from renet.evaluation.adapters.models import Model
from renet.interface import DEPTH_RANGE, PROPRIOCEPTION


class Adapter(base.Adapter):
    """One observation and one image, without history."""

    uses_camera = True

    def __init__(self, model: Model, num_robots: int) -> None:
        super().__init__(model, num_robots)
        robot = read_manifest(pretrained(self.bundle)).robot
        self._pose = np.asarray(robot.arrays["default_position"], np.float32)
        self._scale = robot.action_scale
        self._action = np.zeros((num_robots, 12), np.float32)

    def reset(self, mask: np.ndarray) -> None:
        """Forget the last action."""
        self._action[mask] = 0.0

    def act(self, senses: base.Senses) -> np.ndarray:
        """Joint targets, [N, 12] rad."""
        parts = {
            "base_angular_velocity": senses.angular_velocity,
            "projected_gravity": senses.gravity,
            "command": senses.command,
            "joint_position": senses.joint_position - self._pose,
            "joint_velocity": senses.joint_velocity,
            "last_action": self._action,
        }
        scaled = [parts[term.name] * term.scale for term in PROPRIOCEPTION]
        observation = np.concatenate(scaled, axis=1)
        self._action = self.model.run(observation, senses.depth / DEPTH_RANGE)[0]
        return self._pose + self._scale * self._action
