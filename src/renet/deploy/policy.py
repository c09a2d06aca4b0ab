"""The deployed policy: three ONNX models and the memory between their ticks, for N robots."""

from __future__ import annotations

from typing import Any

import numpy as np

from renet.deploy.bundle import Bundle
from renet.errors import RenetError
from renet.vocabulary import (
    ACTION_SIZE,
    DEPTH_SHAPE,
    FEET,
    FRAMES,
    HEIGHT_MAP_SIZE,
    LATENT,
    PROPRIOCEPTION_SIZE,
    STEPS_PER_TICK,
)


class Policy:
    """Runs a bundle at 50 Hz; every fifth step is a 10 Hz tick of the estimators and of vision.

    Mirrors training: after a reset latents are zero, the history is filled with the first o_t and
    both frames with the first image. Both estimators always run, so that a switch finds a warm
    state. A robot reset between ticks waits for the next one with zero latents.
    """

    def __init__(self, bundle: Bundle, num_robots: int = 1) -> None:
        self.manifest, self._sessions = bundle.manifest, bundle.sessions
        n = self.num_robots = num_robots
        self._history = np.zeros((n, self.manifest.history, PROPRIOCEPTION_SIZE), np.float32)
        self._frames = np.zeros((n, FRAMES, *DEPTH_SHAPE), np.float32)
        self.latent_op = np.zeros((n, LATENT), np.float32)
        self.latent_vp = np.zeros((n, LATENT), np.float32)
        self.velocity_op = np.zeros((n, 3), np.float32)
        self.velocity_vp = np.zeros((n, 3), np.float32)
        self.feet_height = np.zeros((n, FEET), np.float32)
        self.height_map = np.zeros((n, HEIGHT_MAP_SIZE), np.float32)
        self.reconstruction = np.zeros((n, FRAMES, *DEPTH_SHAPE), np.float32)
        self.anomaly_score = np.zeros(n, np.float32)
        """Loss_ad of the newest images, [N]; infinite without a camera."""
        self.ticked = False
        """Whether the last step was a tick."""
        self._blank = np.ones(n, bool)
        self._fresh = np.ones(n, bool)
        self._step = 0

    def reset(self, mask: np.ndarray | None = None) -> None:
        """Forget the masked robots; resetting all restarts the 10 Hz clock."""
        if mask is None:
            self._step = 0
        rows = slice(None) if mask is None else np.asarray(mask, bool)
        for array in (self.latent_op, self.latent_vp, self.anomaly_score):
            array[rows] = 0.0
        self._blank[rows] = self._fresh[rows] = True

    def step(
        self, proprioception: np.ndarray, depth: np.ndarray | None, op_mask: np.ndarray
    ) -> np.ndarray:
        """One control step.

        Args:
            proprioception: o_t, [N, 45]. depth: newest image [N, 48, 64] in [0, 1], read at ticks;
            None without a camera. op_mask: [N] bool, the paper's mask: true where OP acts.

        Returns:
            Actions [N, 12] in policy units, clipped as in training.

        Raises:
            RenetError: wrong shape, or a number that is not finite. The memory is then unchanged.
        """
        proprioception = self._checked(proprioception, "proprioception", (PROPRIOCEPTION_SIZE,))
        self.ticked = self._step % STEPS_PER_TICK == 0
        if self.ticked and depth is not None:
            depth = self._checked(depth, "depth image", DEPTH_SHAPE)
        mask = np.ones(self.num_robots, bool) if depth is None else np.asarray(op_mask, bool)
        self._remember(proprioception)
        if self.ticked:
            self._tick(depth)
        inputs = {
            "proprioception": proprioception,
            "latent_op": self.latent_op,
            "latent_vp": self.latent_vp,
            "op_mask": mask.reshape(-1, 1).astype(np.float32),
        }
        (action,) = self._sessions["actor"].run(None, inputs)
        self._step += 1
        clip = self.manifest.robot.action_clip
        return np.clip(action.reshape(self.num_robots, ACTION_SIZE), -clip, clip)

    def joint_target(self, action: np.ndarray) -> np.ndarray:
        """Joint positions [N, 12] in rad that an action asks for."""
        robot = self.manifest.robot
        return np.asarray(robot.default_position) + robot.action_scale * action

    def _checked(self, value: np.ndarray, name: str, shape: tuple[int, ...]) -> np.ndarray:
        value = np.asarray(value, np.float32)
        expected = (self.num_robots, *shape)
        if value.shape != expected:
            raise RenetError(f"the {name} has shape {value.shape}, expected {expected}")
        if not np.isfinite(value).all():
            raise RenetError(f"the {name} contains NaN or infinity")
        return value

    def _remember(self, proprioception: np.ndarray) -> None:
        self._history[:, :-1] = self._history[:, 1:]
        self._history[:, -1] = proprioception
        self._history[self._blank] = proprioception[self._blank, None]
        self._blank[:] = False

    def _tick(self, depth: np.ndarray | None) -> None:
        """Advance vision and both estimators."""
        if depth is None:
            self.anomaly_score[:] = np.inf
        else:
            self._frames[:, 1] = np.where(self._fresh[:, None, None], depth, self._frames[:, 0])
            self._frames[:, 0] = depth
            outputs: Any = self._sessions["vision"].run(
                ("reconstruction", "anomaly_score"), {"depth": self._frames}
            )
            self.reconstruction, self.anomaly_score[:] = outputs
        self._fresh[:] = False
        names = ("next_latent_op", "next_latent_vp", "velocity_op", "velocity_vp")
        names += ("feet_height", "height_map")
        results = self._sessions["estimator"].run(
            names,
            {
                "proprioception_history": self._history,
                "depth": self._frames,
                "latent_op": self.latent_op,
                "latent_vp": self.latent_vp,
            },
        )
        for name, value in zip(names, results, strict=True):
            setattr(self, name.removeprefix("next_"), value)
