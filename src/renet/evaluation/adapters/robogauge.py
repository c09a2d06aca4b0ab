"""RoboGauge's mixture of experts on the Go2 (arXiv 2602.00678, MIT), which sees no image.

The file is resources/models/go2/go2_moe_cts_124k.pt of github.com/wty-yy/RoboGauge, whose
robogauge/tasks/robots/go2 says what its inputs are.
"""

import numpy as np

from renet.evaluation.adapters import base
from renet.evaluation.adapters.models import Model
from renet.evaluation.adapters.order import LEFT_FIRST

POSE = np.array((0.1, 0.8, -1.5, -0.1, 0.8, -1.5, 0.1, 1.0, -1.5, -0.1, 1.0, -1.5), np.float32)
"""Joint positions that actions are added to, rad, legs FL, FR, RL, RR."""
SCALE = 0.25
"""rad of joint target per unit of action."""
COMMAND_SCALE = np.array((2.0, 2.0, 0.25), np.float32)


class Adapter(base.Adapter):
    """One observation of 45 numbers; the module keeps its history itself, of one robot."""

    bundle = "go2-parkour"
    stiffness = 20.0
    damping = 0.5

    def __init__(self, model: Model, num_robots: int) -> None:
        super().__init__(model, num_robots)
        self._action = np.zeros((num_robots, 12), np.float32)

    def reset(self, mask: np.ndarray) -> None:
        """Forget the last action, and let the module forget."""
        self._action[mask] = 0.0
        for robot in np.flatnonzero(mask).tolist():
            self.model.reset(robot)

    def act(self, senses: base.Senses) -> np.ndarray:
        """Joint targets, [N, 12] rad."""
        observation = np.concatenate(
            (
                senses.angular_velocity * 0.25,
                senses.gravity,
                senses.command * COMMAND_SCALE,
                senses.joint_position[:, LEFT_FIRST] - POSE,
                senses.joint_velocity[:, LEFT_FIRST] * 0.05,
                self._action,
            ),
            axis=1,
        )
        rows = [self.model.run(row[None], robot=robot)[0] for robot, row in enumerate(observation)]
        self._action = np.concatenate(rows)
        return (POSE + SCALE * self._action)[:, LEFT_FIRST]
