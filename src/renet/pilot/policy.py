"""The policy of a bundle for N robots: three ONNX models and the memory between their ticks."""

from collections.abc import Callable, Iterable
from typing import Any, Protocol

import numpy as np

from renet.bundle import Bundle
from renet.bundle.models import MAP_ERROR, model_shapes
from renet.errors import RenetError
from renet.interface import (
    ACTION_SIZE,
    DEPTH_SHAPE,
    PROPRIOCEPTION_SIZE,
    STEPS_PER_TICK,
    TICK_DT,
)
from renet.pilot.inference import InlineInference
from renet.pilot.tick import (
    OF_OP,
    OF_VP,
    SCORES,
    EstimatorInput,
    EstimatorOutput,
    Sessions,
    infer,
)
from renet.selector.monitors import Gate

LARGEST_RESULT = 1e4
"""Largest plausible result of an estimator, in any unit. Beyond it, the estimator diverges."""


class Policy(Protocol):
    """Interface of policies that a pilot can drive robots with, such as `BundlePolicy`.

    Other attributes are optional. Monitors compare `velocity_op` and `velocity_vp` ([N, 3] m/s),
    and judge `variance_score`, `surprise` and `stillness` ([N] each) and `map_error` ([N] m). A
    policy with `has_image` ([N] bool) can walk without an image, and its `step` also takes a
    `gate`. A policy with `retire(mask)` need not act for robots whose trial is over, until all are
    reset.
    """

    anomaly_score: np.ndarray
    """Score of the newest images, [N], on any scale; larger for images unlike those of training."""

    def reset(self, mask: np.ndarray | None = None) -> None:
        """Forget the past of the masked robots [N], of all by default."""

    def step(self, proprioception: np.ndarray, depth: Any, op_mask: np.ndarray) -> np.ndarray:
        """Compute actions, [N, 12].

        Args:
            proprioception: Observation o_t, [N, 45].
            depth: Newest images, [N, 48, 64] in [0, 1]; None without a camera.
            op_mask: The paper's mask, True where OP is to act, [N] bool.
        """
        ...


class BundlePolicy:
    """Policy of a bundle at 50 Hz; every fifth step is a 10 Hz tick of estimators and vision.

    It works as in training: after a reset the latents are zero, the history is filled with the
    first o_t, and both frames with the first image. Both estimators always run, so that the latent
    of either is up to date when the robot switches to it. A robot that is reset between ticks has
    zero latents until the next one.
    """

    def __init__(
        self,
        bundle: Bundle,
        num_robots: int = 1,
        inference: Callable[[Sessions], InlineInference] = InlineInference,
    ) -> None:
        """Initialize a policy of N robots; `inference` runs its ticks, by default in line."""
        self.manifest = bundle.manifest
        self.sessions = bundle.sessions
        self.inference = inference(bundle.sessions)
        self.num_robots = num_robots
        n = num_robots
        shapes = model_shapes(self.manifest.history)
        inputs, estimates = shapes["estimator"]

        def zeros(shape: tuple[int, ...]) -> np.ndarray:
            return np.zeros((n, *shape), np.float32)

        self._history = zeros(inputs["proprioception_history"])
        """Last observations, oldest first, [N, H, 45]."""
        self._frames = zeros(inputs["depth"])
        """Last two images, newest first, [N, 2, 48, 64]."""
        self.latent_op = zeros(inputs["latent_op"])
        self.latent_vp = zeros(inputs["latent_vp"])
        self.velocity_op = zeros(estimates["velocity_op"])
        self.velocity_vp = zeros(estimates["velocity_vp"])
        """Velocity of the base that VP estimates, base frame, [N, 3] m/s."""
        self.feet_height = zeros(estimates["feet_height"])
        self.height_map = zeros(estimates["height_map"])
        self.map_error = np.zeros(n, np.float32)
        """Error of the height map ahead that VP expects, [N] m; zero if the model predicts none."""
        self.has_image = np.ones(n, bool)
        """True where VP's newest tick had an image, [N] bool."""
        self.accepted = zeros(inputs["depth"])
        """Two newest images that VP was given, newest first, [N, 2, 48, 64]."""
        self.reconstruction = zeros(shapes["vision"][1]["reconstruction"])
        """Reconstructions of the newest images, which stay in a tick without an image."""
        self.anomaly_score = np.zeros(n, np.float32)
        """Loss_ad of the newest images, [N]; infinite without a camera."""
        self.variance_score = np.zeros(n, np.float32)
        """Squared error over predicted variance, [N]; infinite without a camera, and otherwise zero
        if the model predicts none."""
        self.surprise = np.zeros(n, np.float32)
        """Contradiction between the newest images and what was expected, [N]; infinite without a
        camera, and otherwise zero if the model expects no images."""
        self.stillness = np.zeros(n, np.float32)
        """Share of the expected change that the last images lack, [N]; infinite without a camera,
        and otherwise zero if the model expects no images."""
        self.evidence = np.zeros((n, 2), np.float32)
        """Evidence of the images' motion, [N, 2] (see `bundle.models.EVIDENCE`)."""
        self.image_age = np.full(n, np.nan)
        """Time for which images have been withheld, [N] s; NaN where VP was never given one."""
        self.vp_lost = np.zeros(n, bool)
        """True where VP's newest results are not finite, [N] bool: OP must drive, and VP begins
        with an empty memory."""
        self.op_lost = np.zeros(n, bool)
        """True where OP's newest results are not finite, [N] bool: the robot must brake."""
        self.inferred = False
        """True if the newest step received the result of a tick."""
        self.fallback = False
        """True if the newest tick ran in line without an image, because the one before was late or
        its thread has died."""
        # Robots whose history, and whose frames, are still empty.
        self._blank = np.ones(n, bool)
        self._fresh = np.ones(n, bool)
        # Rows of the robots that have not retired; None for all.
        self._driven: np.ndarray | None = None
        self._step = 0

    def reset(self, mask: np.ndarray | None = None) -> None:
        """Forget the past of the masked robots, [N] bool, by default of all.

        A reset of all robots also restarts the 10 Hz clock, and lets retired robots act again.
        """
        if mask is None:
            self._step = 0
            self._driven = None
            self.fallback = False
            self.inference.reset()
        rows = slice(None) if mask is None else np.asarray(mask, bool)
        for name in ("latent_op", "latent_vp", MAP_ERROR, "evidence", *SCORES):
            # Into a copy, because a tick on another thread may still read the old array.
            value = getattr(self, name).copy()
            value[rows] = 0.0
            setattr(self, name, value)
        self.has_image = self.has_image.copy()
        self.has_image[rows] = True
        self.image_age = self.image_age.copy()
        self.image_age[rows] = np.nan
        self.vp_lost[rows] = False
        self.op_lost[rows] = False
        self._blank[rows] = True
        self._fresh[rows] = True

    def retire(self, mask: np.ndarray) -> None:
        """Stop computing for the masked robots, [N] bool, until all are reset.

        Their actions are zero, and their estimates stay as they are. Results of the other robots do
        not change by a single bit.
        """
        self._driven = np.flatnonzero(~mask)

    def close(self) -> None:
        """Stop the thread that runs the ticks, if there is one."""
        self.inference.close()

    @property
    def due(self) -> bool:
        """True if the next step is a tick."""
        return self._step % STEPS_PER_TICK == 0

    def step(
        self,
        proprioception: np.ndarray,
        depth: np.ndarray | None,
        op_mask: np.ndarray,
        gate: Gate | None = None,
    ) -> np.ndarray:
        """Take one control step.

        Args:
            proprioception: Observation o_t, [N, 45].
            depth: Newest images, [N, 48, 64] in [0, 1], read at ticks; None without a camera.
            op_mask: The paper's mask, True where OP acts, [N] bool.
            gate: At ticks, the gate that withholds images from VP; by default none.

        Returns:
            Actions in policy units, clipped as in training, [N, 12].

        Raises:
            RenetError: An input has another shape, is not finite, or depth is outside [0, 1]. The
                memory is then unchanged.
        """
        shape = (self.num_robots, PROPRIOCEPTION_SIZE)
        proprioception = checked(proprioception, "proprioception", shape)
        if self.due and depth is not None:
            depth = checked_depth(depth, self.num_robots, self.manifest.camera.range)
        self._remember(proprioception)
        self.inferred = False
        if self.due:
            self._begin_tick(depth, gate)
        # A tick in line is done by now; for one on a thread this waits a few milliseconds at most.
        output = self.inference.take()
        if output is not None:
            self._accept(output)
        mask = np.ones(self.num_robots, bool) if depth is None else np.asarray(op_mask, bool)
        return self._act(proprioception, mask | self.vp_lost)

    def joint_target(self, action: np.ndarray) -> np.ndarray:
        """Return the joint positions to which actions [N, 12] drive, [N, 12] rad."""
        robot = self.manifest.robot
        return robot.arrays["default_position"] + robot.action_scale * action

    def _remember(self, proprioception: np.ndarray) -> None:
        """Add o_t, [N, 45], to the history."""
        self._history[:, :-1] = self._history[:, 1:]
        self._history[:, -1] = proprioception
        # The first observation after a reset fills the history.
        if self._blank.any():
            self._history[self._blank] = proprioception[self._blank, None]
            self._blank[:] = False

    def _begin_tick(self, depth: np.ndarray | None, gate: Gate | None) -> None:
        """Start a tick; if the one before is late, run this one here, without an image."""
        self.fallback = not self.inference.ready()
        inputs = self._look(None if self.fallback else depth, gate)
        if self._driven is not None:
            inputs = inputs.robots(self._driven)
        if self.fallback:
            self._accept(infer(self.sessions, inputs))
        else:
            self.inference.begin(inputs)

    def _look(self, depth: np.ndarray | None, gate: Gate | None) -> EstimatorInput:
        """Add an image [N, 48, 64] to the frames, if there is one; returns the tick's inputs."""
        unpaired = self._fresh | ~self.has_image
        if depth is not None:
            self._frames[:, 1] = np.where(self._fresh[:, None, None], depth, self._frames[:, 0])
            self._frames[:, 0] = depth
            self._fresh[:] = False
        feed = {
            "proprioception_history": self._history.copy(),
            "latent_op": self.latent_op,
            "latent_vp": self.latent_vp,
        }
        frames = self._frames.copy()
        return EstimatorInput(
            feed=feed,
            depth=frames,
            accepted=self.accepted,
            unpaired=unpaired,
            image_age=self.image_age,
            evidence=self.evidence,
            gate=gate,
            blind=depth is None,
        )

    def _accept(self, result: EstimatorOutput) -> None:
        """Store the results of a tick, of the robots that have not retired."""
        for name, value in result.items():
            if self._driven is not None:
                # Into a copy (see `reset`).
                whole = getattr(self, name).copy()
                whole[self._driven] = value
                value = whole
            setattr(self, name, value)
        if "has_image" in result:
            self.image_age = np.where(self.has_image, 0.0, self.image_age + TICK_DT)
        self.inferred = True
        self._find_lost(result)

    def _find_lost(self, result: EstimatorOutput) -> None:
        """Find estimators whose results are not finite, and clear the memory of such VPs."""
        self.op_lost = ~self._sane(OF_OP)
        self.vp_lost = ~self._sane([name for name in OF_VP if name in result])
        if not self.vp_lost.any():
            return
        for name in OF_VP:
            value = getattr(self, name).copy()
            value[self.vp_lost] = 0.0
            setattr(self, name, value)
        self.has_image = self.has_image & ~self.vp_lost

    def _sane(self, names: Iterable[str]) -> np.ndarray:
        """Return a mask of robots whose attributes `names` are finite and not huge, [N] bool."""
        sane = np.ones(self.num_robots, bool)
        for name in names:
            value = np.abs(getattr(self, name)).reshape(self.num_robots, -1)
            # The comparison is False for NaN, too.
            sane &= (value <= LARGEST_RESULT).all(axis=1)
        return sane

    def _act(self, proprioception: np.ndarray, op_mask: np.ndarray) -> np.ndarray:
        """Run the actor, which ends the control step.

        Args:
            proprioception: Observation o_t, [N, 45].
            op_mask: The paper's mask, True where OP acts, [N] bool.

        Returns:
            Actions, [N, 12].
        """
        driven = slice(None) if self._driven is None else self._driven
        inputs = {
            "proprioception": proprioception[driven],
            "latent_op": self.latent_op[driven],
            "latent_vp": self.latent_vp[driven],
            "op_mask": op_mask.reshape(-1, 1)[driven].astype(np.float32),
        }
        outputs: Any = self.sessions["actor"].run(["action"], inputs)
        self._step += 1
        clip = self.manifest.robot.action_clip
        action = np.zeros((self.num_robots, ACTION_SIZE), np.float32)
        action[driven] = np.minimum(np.maximum(outputs[0], -clip), clip)
        return action


def checked(value: np.ndarray, name: str, shape: tuple[int, ...]) -> np.ndarray:
    """Convert an array to float32; raises RenetError if it has another shape or is not finite."""
    value = np.asarray(value, np.float32)
    if value.shape != shape:
        raise RenetError(f"the {name} has shape {value.shape}, expected {shape}")
    if not np.isfinite(value).all():
        raise RenetError(f"the {name} contains NaN or infinity")
    return value


def checked_depth(depth: np.ndarray, num_robots: int, metres: float) -> np.ndarray:
    """Convert depth images to float32.

    Args:
        depth: Images, [N, 48, 64] in [0, 1].
        num_robots: Number of robots, N.
        metres: Distance of a pixel of 1, m, for the message.

    Raises:
        RenetError: The images have another shape, are not finite, or are outside [0, 1].
    """
    depth = checked(depth, "depth image", (num_robots, *DEPTH_SHAPE))
    if depth.min() < 0.0 or depth.max() > 1.0:
        raise RenetError(
            f"the depth image must be in [0, 1], not {depth.min():g} to {depth.max():g}:"
            f" divide metres by {metres:g} and clip"
        )
    return depth
