"""HIMLoco on the Go2 (Long et al. 2024), which sees no image, as rl_sar ships it (Apache-2.0).

The file is policy/go2/himloco/himloco.pt of github.com/fan-ziqi/rl_sar; config.yaml beside it
defines the inputs.
"""

import numpy as np

from renet.evaluation.adapters import base
from renet.evaluation.adapters.models import Model

_COMMAND_SCALE = np.array((2.0, 2.0, 0.25), np.float32)
"""Factors of v_x, v_y and omega_z in the observation."""
_HISTORY = 6
"""Number of observations in the model's input, newest first."""


class Adapter(base.OffsetAdapter):
    """Policy with a history of six observations of 45 numbers."""

    bundle = "go2-parkour"
    stiffness = 40.0
    damping = 1.0
    # Legs in the order FL, FR, RL, RR.
    pose = np.array((0.1, 0.8, -1.5, -0.1, 0.8, -1.5, 0.1, 1.0, -1.5, -0.1, 1.0, -1.5), np.float32)
    action_scale = np.array((0.125, 0.25, 0.25) * 4, np.float32)

    def __init__(self, model: Model, num_robots: int) -> None:
        super().__init__(model, num_robots)
        self._history = np.zeros((num_robots, _HISTORY, 45), np.float32)
        self._blank = np.ones(num_robots, bool)
        """True where the next observation fills the whole history, [N]."""

    def reset(self, mask: np.ndarray) -> None:
        """Clear the last action and the history of the masked robots, [N] bool."""
        super().reset(mask)
        self._blank[mask] = True

    def act(self, senses: base.Senses) -> np.ndarray:
        """Return joint targets, [N, 12] rad."""
        observation = np.concatenate(
            (
                senses.command * _COMMAND_SCALE,
                senses.angular_velocity * 0.25,
                senses.gravity,
                senses.joint_position[:, base.LEFT_FIRST] - self.pose,
                senses.joint_velocity[:, base.LEFT_FIRST] * 0.05,
                self._action,
            ),
            axis=1,
        )
        # Shift the history by one step; after a reset the first observation fills all of it.
        self._history[:, 1:] = self._history[:, :-1].copy()
        self._history[:, 0] = observation
        self._history[self._blank] = observation[self._blank, None]
        self._blank[:] = False
        self._action = self.model.run(self._history.reshape(self.num_robots, -1))[0]
        # The order of legs is its own inverse.
        return self._target()[:, base.LEFT_FIRST]
