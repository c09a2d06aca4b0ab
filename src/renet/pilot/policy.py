"""The policy of a bundle for N robots: three ONNX models and the memory between their ticks."""

from collections.abc import Callable, Iterable
from typing import Any, Protocol

import numpy as np

from renet.bundle import Bundle
from renet.bundle.models import MAP_ERROR, model_shapes
from renet.errors import RenetError
from renet.interface import ACTION_SIZE, DEPTH_SHAPE, PROPRIOCEPTION_SIZE, STEPS_PER_TICK
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

LARGEST = 1e4
"""Beyond this a latent, m/s or m is no number either: an overflow on its way to infinity."""


class Policy(Protocol):
    """Anybody's policy, as a pilot needs it: `BundlePolicy` is one.

    Further attributes are optional. The monitors compare `velocity_op` and `velocity_vp` ([N, 3]
    m/s), and judge `variance_score` ([N]) and `map_error` ([N] m). A policy with `has_image`
    ([N] bool) can do without an image: its `step` takes a `gate` as well. One with `retire(mask)`
    need not act for robots whose try is over, until all are reset.
    """

    anomaly_score: np.ndarray
    """[N] how unlike its training images the last frames were; any scale."""

    def reset(self, mask: np.ndarray | None = None) -> None:
        """Forget the past of the masked robots [N], of all by default."""

    def step(self, proprioception: np.ndarray, depth: Any, op_mask: np.ndarray) -> np.ndarray:
        """Actions [N, 12].

        Args:
            proprioception: o_t, [N, 45].
            depth: newest images [N, 48, 64] in [0, 1]; None without a camera.
            op_mask: [N] bool, the paper's mask: true where OP is to act.
        """
        ...


class BundlePolicy:
    """Runs a bundle at 50 Hz; every fifth step is a 10 Hz tick of the estimators and of vision.

    Mirrors training: after a reset latents are zero, the history is filled with the first o_t and
    both frames with the first image. Both estimators always run, so that a switch finds a warm
    state. A robot reset between ticks waits for the next one with zero latents.
    """

    def __init__(
        self,
        bundle: Bundle,
        num_robots: int = 1,
        inference: Callable[[Sessions], InlineInference] = InlineInference,
    ) -> None:
        """Set up for N robots; `inference` makes what runs the ticks, in line by default."""
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
        """Oldest first."""
        self._frames = zeros(inputs["depth"])
        """Newest first."""
        self.latent_op = zeros(inputs["latent_op"])
        self.latent_vp = zeros(inputs["latent_vp"])
        self.velocity_op = zeros(estimates["velocity_op"])
        self.velocity_vp = zeros(estimates["velocity_vp"])
        """Base frame, m/s, as OP's."""
        self.feet_height = zeros(estimates["feet_height"])
        self.height_map = zeros(estimates["height_map"])
        self.map_error = np.zeros(n, np.float32)
        """Error of the height map ahead that VP expects, [N] m; zero from models that predict
        none."""
        self.has_image = np.ones(n, bool)
        """Whether VP's newest tick had an image, [N]."""
        self.accepted = zeros(inputs["depth"])
        """The two newest images that VP was given, newest first."""
        self.reconstruction = zeros(shapes["vision"][1]["reconstruction"])
        """Reconstructions of the newest images; a blind tick keeps the earlier ones."""
        self.anomaly_score = np.zeros(n, np.float32)
        """Loss_ad of the newest images, [N]; infinite without a camera."""
        self.variance_score = np.zeros(n, np.float32)
        """Squared error over predicted variance, [N]; infinite without a camera, else zero from
        models that predict none."""
        self.vp_lost = np.zeros(n, bool)
        """Whether VP's newest tick found no numbers, [N]: OP must drive. VP forgets, and begins
        anew."""
        self.op_lost = np.zeros(n, bool)
        """Whether OP's newest tick found none, [N]: the robot must brake."""
        self.inferred = False
        """Whether the newest step took over the result of a tick."""
        self.fallback = False
        """Whether the newest tick ran blind and in line, because the one before was late or its
        thread is dead."""
        self._blank = np.ones(n, bool)
        self._fresh = np.ones(n, bool)
        self._driven: np.ndarray | None = None
        """Rows of the robots that have not retired; None: all."""
        self._step = 0

    def reset(self, mask: np.ndarray | None = None) -> None:
        """Forget the masked robots; resetting all restarts the 10 Hz clock, and none is retired."""
        if mask is None:
            self._step = 0
            self._driven = None
            self.fallback = False
        rows = slice(None) if mask is None else np.asarray(mask, bool)
        for name in ("latent_op", "latent_vp", MAP_ERROR, *SCORES):
            # Copies: a tick on another thread may still read the old arrays.
            value = getattr(self, name).copy()
            value[rows] = 0.0
            setattr(self, name, value)
        self.has_image = self.has_image.copy()
        self.has_image[rows] = True
        self.vp_lost[rows] = False
        self.op_lost[rows] = False
        self._blank[rows] = True
        self._fresh[rows] = True

    def retire(self, mask: np.ndarray) -> None:
        """Compute nothing more for the masked robots [N], until all are reset.

        Their actions in `step` are zero, and their estimates stay. Those of the other robots are
        the same, to the last digit, as beside them.
        """
        self._driven = np.flatnonzero(~mask)

    def close(self) -> None:
        """Stop the thread of the ticks, if there is one."""
        self.inference.close()

    @property
    def due(self) -> bool:
        """Whether the next step is a tick."""
        return self._step % STEPS_PER_TICK == 0

    def step(
        self,
        proprioception: np.ndarray,
        depth: np.ndarray | None,
        op_mask: np.ndarray,
        gate: Gate | None = None,
    ) -> np.ndarray:
        """One control step.

        Args:
            proprioception: o_t, [N, 45].
            depth: newest image [N, 48, 64] in [0, 1], read at ticks; None without a camera.
            op_mask: [N] bool, the paper's mask: true where OP acts.
            gate: at ticks, which images VP may use; all by default.

        Returns:
            Actions [N, 12] in policy units, clipped as in training.

        Raises:
            RenetError: wrong shape, a number that is not finite, or depth outside [0, 1]. The
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
        # A tick in line is done by now; one on a thread is waited for a few milliseconds at most.
        output = self.inference.take()
        if output is not None:
            self._accept(output)
        mask = np.ones(self.num_robots, bool) if depth is None else np.asarray(op_mask, bool)
        return self._act(proprioception, mask | self.vp_lost)

    def joint_target(self, action: np.ndarray) -> np.ndarray:
        """Joint positions [N, 12] in rad that an action asks for."""
        robot = self.manifest.robot
        return robot.arrays["default_position"] + robot.action_scale * action

    def _remember(self, proprioception: np.ndarray) -> None:
        """Push o_t [N, 45] onto the history."""
        self._history[:, :-1] = self._history[:, 1:]
        self._history[:, -1] = proprioception
        if self._blank.any():
            self._history[self._blank] = proprioception[self._blank, None]
            self._blank[:] = False

    def _begin_tick(self, depth: np.ndarray | None, gate: Gate | None) -> None:
        """Start a tick; where the one before is late, run this one here and blind."""
        self.fallback = not self.inference.ready()
        inputs = self._look(None if self.fallback else depth, gate)
        if self._driven is not None:
            inputs = inputs.robots(self._driven)
        if self.fallback:
            self._accept(infer(self.sessions, inputs))
        else:
            self.inference.begin(inputs)

    def _look(self, depth: np.ndarray | None, gate: Gate | None) -> EstimatorInput:
        """Push an image [N, 48, 64], if there is one; returns what a tick reads."""
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
        return EstimatorInput(feed, frames, self.accepted, unpaired, gate, blind=depth is None)

    def _accept(self, result: EstimatorOutput) -> None:
        """Take over the output of a tick, of the robots that have not retired."""
        for name, value in result.items():
            if self._driven is not None:
                # A copy, as in `reset`.
                whole = getattr(self, name).copy()
                whole[self._driven] = value
                value = whole
            setattr(self, name, value)
        self.inferred = True
        self._find_lost(result)

    def _find_lost(self, result: EstimatorOutput) -> None:
        """Notice estimators that found no numbers, and let VP forget what it cannot go on from."""
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
        """[N] bool: whether all numbers of some attributes are finite and not huge."""
        sane = np.ones(self.num_robots, bool)
        for name in names:
            value = np.abs(getattr(self, name)).reshape(self.num_robots, -1)
            sane &= (value <= LARGEST).all(axis=1)
        return sane

    def _act(self, proprioception: np.ndarray, op_mask: np.ndarray) -> np.ndarray:
        """Actions [N, 12] under the paper's mask [N] bool; ends the control step."""
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
    """An array as float32; raises RenetError unless it has that shape and is finite."""
    value = np.asarray(value, np.float32)
    if value.shape != shape:
        raise RenetError(f"the {name} has shape {value.shape}, expected {shape}")
    if not np.isfinite(value).all():
        raise RenetError(f"the {name} contains NaN or infinity")
    return value


def checked_depth(depth: np.ndarray, num_robots: int, metres: float) -> np.ndarray:
    """Depth images [N, 48, 64] as float32; `metres` is the distance that 1 stands for.

    Raises RenetError for another shape, a number that is not finite, or one outside [0, 1].
    """
    depth = checked(depth, "depth image", (num_robots, *DEPTH_SHAPE))
    if depth.min() < 0.0 or depth.max() > 1.0:
        raise RenetError(
            f"the depth image must be in [0, 1], not {depth.min():g} to {depth.max():g}:"
            f" divide metres by {metres:g} and clip"
        )
    return depth
