"""MuJoCo Playground's Go1 joystick policy, which sees no image (Apache-2.0).

The file is mujoco_playground/experimental/sim2sim/onnx/go1_policy.onnx of
github.com/google-deepmind/mujoco_playground. It reads the base's true velocity, which no robot
measures.
"""

import numpy as np

from renet.evaluation.adapters import base


class Adapter(base.OffsetAdapter):
    """Policy with one observation of 48 numbers, without history, in batches of one."""

    bundle = "go1-parkour"
    stiffness = 35.0
    damping = 0.5
    needs_velocity = True
    pose = np.array((0.1, 0.9, -1.8, -0.1, 0.9, -1.8, 0.1, 0.9, -1.8, -0.1, 0.9, -1.8), np.float32)
    action_scale = 0.5

    def act(self, senses: base.Senses) -> np.ndarray:
        """Return joint targets, [N, 12] rad."""
        # Joints are in renet's own order.
        observation = np.concatenate(
            (
                senses.velocity,
                senses.angular_velocity,
                senses.gravity,
                senses.joint_position - self.pose,
                senses.joint_velocity,
                self._action,
                senses.command,
            ),
            axis=1,
        )
        # The exported graph has a batch size of one.
        rows = []
        for row in observation:
            rows.append(self.model.run(row[None])[0])
        self._action = np.concatenate(rows).astype(np.float32)
        return self._target()
