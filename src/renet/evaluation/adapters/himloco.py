"""HIMLoco on the Go2 (Long et al. 2024), which sees no image, as rl_sar ships it (Apache-2.0).

The file is policy/go2/himloco/himloco.pt of github.com/fan-ziqi/rl_sar; config.yaml beside it says
what its inputs are.
"""

import numpy as np

from renet.evaluation.adapters import base
from renet.evaluation.adapters.models import Model
from renet.evaluation.adapters.order import LEFT_FIRST

POSE = np.array((0.1, 0.8, -1.5, -0.1, 0.8, -1.5, 0.1, 1.0, -1.5, -0.1, 1.0, -1.5), np.float32)
"""Joint positions that actions are added to, rad, legs FL, FR, RL, RR."""
SCALE = np.array((0.125, 0.25, 0.25) * 4, np.float32)
"""rad of joint target per unit of action."""
COMMAND_SCALE = np.array((2.0, 2.0, 0.25), np.float32)
HISTORY = 6
"""Observations of 45 numbers, the newest first."""


class Adapter(base.Adapter):
    """A history of six observations."""

    bundle = "go2-parkour"
    stiffness = 40.0
    damping = 1.0

    def __init__(self, model: Model, num_robots: int) -> None:
        super().__init__(model, num_robots)
        self._action = np.zeros((num_robots, 12), np.float32)
        self._history = np.zeros((num_robots, HISTORY, 45), np.float32)
        self._blank = np.ones(num_robots, bool)

    def reset(self, mask: np.ndarray) -> None:
        """Forget the last action, and the history."""
        self._action[mask] = 0.0
        self._blank[mask] = True

    def act(self, senses: base.Senses) -> np.ndarray:
        """Joint targets, [N, 12] rad."""
        observation = np.concatenate(
            (
                senses.command * COMMAND_SCALE,
                senses.angular_velocity * 0.25,
                senses.gravity,
                senses.joint_position[:, LEFT_FIRST] - POSE,
                senses.joint_velocity[:, LEFT_FIRST] * 0.05,
                self._action,
            ),
            axis=1,
        )
        self._history[:, 1:] = self._history[:, :-1].copy()
        self._history[:, 0] = observation
        self._history[self._blank] = observation[self._blank, None]
        self._blank[:] = False
        self._action = self.model.run(self._history.reshape(self.num_robots, -1))[0]
        # The order of legs is its own inverse.
        return (POSE + SCALE * self._action)[:, LEFT_FIRST]
