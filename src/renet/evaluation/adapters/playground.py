"""MuJoCo Playground's Go1 joystick policy, which sees no image (Apache-2.0).

The file is mujoco_playground/experimental/sim2sim/onnx/go1_policy.onnx of
github.com/google-deepmind/mujoco_playground. It reads the base's true velocity, which no robot
measures.
"""

import numpy as np

from renet.evaluation.adapters import base
from renet.evaluation.adapters.models import Model

POSE = np.array((0.1, 0.9, -1.8, -0.1, 0.9, -1.8, 0.1, 0.9, -1.8, -0.1, 0.9, -1.8), np.float32)
"""Joint positions that actions are added to, rad."""
SCALE = 0.5
"""rad of joint target per unit of action."""


class Adapter(base.Adapter):
    """One observation of 48 numbers, without history; a batch of one."""

    bundle = "go1-parkour"
    stiffness = 35.0
    damping = 0.5
    needs_velocity = True

    def __init__(self, model: Model, num_robots: int) -> None:
        super().__init__(model, num_robots)
        self._action = np.zeros((num_robots, 12), np.float32)

    def reset(self, mask: np.ndarray) -> None:
        """Forget the last action."""
        self._action[mask] = 0.0

    def act(self, senses: base.Senses) -> np.ndarray:
        """Joint targets, [N, 12] rad."""
        observation = np.concatenate(
            (
                senses.velocity,
                senses.angular_velocity,
                senses.gravity,
                senses.joint_position - POSE,
                senses.joint_velocity,
                self._action,
                senses.command,
            ),
            axis=1,
        )
        rows = [self.model.run(row[None])[0] for row in observation]
        self._action = np.concatenate(rows).astype(np.float32)
        return POSE + SCALE * self._action
