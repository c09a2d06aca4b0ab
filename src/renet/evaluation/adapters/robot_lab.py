"""robot_lab's rough-ground policy of the Go2, which sees no image, as rl_sar ships it (Apache-2.0).

The file is policy/go2/robot_lab/policy.pt of github.com/fan-ziqi/rl_sar; config.yaml beside it says
what its inputs are.
"""

import numpy as np

from renet.evaluation.adapters import base
from renet.evaluation.adapters.models import Model

POSE = np.array((0.0, 0.8, -1.5) * 4, np.float32)
"""Joint positions that actions are added to, rad."""
SCALE = np.array((0.125, 0.25, 0.25) * 4, np.float32)
"""rad of joint target per unit of action."""


class Adapter(base.Adapter):
    """One observation of 45 numbers, without history."""

    bundle = "go2-parkour"
    stiffness = 20.0
    damping = 0.5

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
                senses.angular_velocity * 0.25,
                senses.gravity,
                senses.command,
                senses.joint_position - POSE,
                senses.joint_velocity * 0.05,
                self._action,
            ),
            axis=1,
        )
        self._action = self.model.run(observation)[0]
        return POSE + SCALE * self._action
