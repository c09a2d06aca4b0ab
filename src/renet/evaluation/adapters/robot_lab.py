"""robot_lab's rough-ground policy of the Go2, which sees no image, as rl_sar ships it (Apache-2.0).

The file is policy/go2/robot_lab/policy.pt of github.com/fan-ziqi/rl_sar; config.yaml beside it
defines the inputs.
"""

import numpy as np

from renet.evaluation.adapters import base


class Adapter(base.OffsetAdapter):
    """Policy with one observation of 45 numbers, without history."""

    bundle = "go2-parkour"
    stiffness = 20.0
    damping = 0.5
    pose = np.array((0.0, 0.8, -1.5) * 4, np.float32)
    action_scale = np.array((0.125, 0.25, 0.25) * 4, np.float32)

    def act(self, senses: base.Senses) -> np.ndarray:
        """Return joint targets, [N, 12] rad."""
        # Joints are in renet's own order.
        observation = np.concatenate(
            (
                senses.angular_velocity * 0.25,
                senses.gravity,
                senses.command,
                senses.joint_position - self.pose,
                senses.joint_velocity * 0.05,
                self._action,
            ),
            axis=1,
        )
        self._action = self.model.run(observation)[0]
        return self._target()
