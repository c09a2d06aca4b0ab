"""RoboGauge's mixture of experts on the Go2 (arXiv 2602.00678, MIT), which sees no image.

The file is resources/models/go2/go2_moe_cts_124k.pt of github.com/wty-yy/RoboGauge, whose
robogauge/tasks/robots/go2 defines the inputs.
"""

import numpy as np

from renet.evaluation.adapters import base

_COMMAND_SCALE = np.array((2.0, 2.0, 0.25), np.float32)
"""Factors of v_x, v_y and omega_z in the observation."""


class Adapter(base.OffsetAdapter):
    """Policy with one observation of 45 numbers, whose module keeps the history of one robot."""

    bundle = "go2-parkour"
    stiffness = 20.0
    damping = 0.5
    # Legs in the order FL, FR, RL, RR.
    pose = np.array((0.1, 0.8, -1.5, -0.1, 0.8, -1.5, 0.1, 1.0, -1.5, -0.1, 1.0, -1.5), np.float32)
    action_scale = 0.25

    def reset(self, mask: np.ndarray) -> None:
        """Clear the last action and the module's history of the masked robots, [N] bool."""
        super().reset(mask)
        for robot in np.flatnonzero(mask).tolist():
            self.model.reset(robot)

    def act(self, senses: base.Senses) -> np.ndarray:
        """Return joint targets, [N, 12] rad."""
        observation = np.concatenate(
            (
                senses.angular_velocity * 0.25,
                senses.gravity,
                senses.command * _COMMAND_SCALE,
                senses.joint_position[:, base.LEFT_FIRST] - self.pose,
                senses.joint_velocity[:, base.LEFT_FIRST] * 0.05,
                self._action,
            ),
            axis=1,
        )
        # Each robot has a module of its own, which takes a batch of one.
        rows = []
        for robot, row in enumerate(observation):
            rows.append(self.model.run(row[None], robot=robot)[0])
        self._action = np.concatenate(rows)
        return self._target()[:, base.LEFT_FIRST]
