"""Models with inputs (observation [N, 45], depth [N, 48, 64]) and output action [N, 12].

They are ONNX or, in spite of the name, TorchScript. The observation is renet's own
(`renet.interface.PROPRIOCEPTION`), the depth is divided by its range of 2 m, and an action of 1
moves a joint target 0.25 rad from the Go1's default pose. This fits policies trained in renet's
tasks, or with the same inputs elsewhere.
"""

import numpy as np

from renet.bundle import pretrained, read_manifest
from renet.evaluation.adapters import base
from renet.evaluation.adapters.models import Model
from renet.interface import DEPTH_RANGE, PROPRIOCEPTION


class Adapter(base.OffsetAdapter):
    """Policy with one observation and one image, without history."""

    uses_camera = True

    def __init__(self, model: Model, num_robots: int) -> None:
        super().__init__(model, num_robots)
        robot = read_manifest(pretrained(self.bundle)).robot
        self.pose = np.asarray(robot.arrays["default_position"], np.float32)
        self.action_scale = robot.action_scale

    def act(self, senses: base.Senses) -> np.ndarray:
        """Return joint targets, [N, 12] rad."""
        parts = {
            "base_angular_velocity": senses.angular_velocity,
            "projected_gravity": senses.gravity,
            "command": senses.command,
            "joint_position": senses.joint_position - self.pose,
            "joint_velocity": senses.joint_velocity,
            "last_action": self._action,
        }
        # The order and the scales of renet's own proprioception.
        scaled = [parts[term.name] * term.scale for term in PROPRIOCEPTION]
        observation = np.concatenate(scaled, axis=1)
        self._action = self.model.run(observation, senses.depth / DEPTH_RANGE)[0]
        return self._target()
