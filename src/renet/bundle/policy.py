"""The deployed policy: three ONNX models and the memory between their ticks, for N robots."""

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from renet.bundle import Bundle
from renet.bundle.blocks import Session
from renet.bundle.models import HAS_IMAGE, MAP_ERROR, model_shapes, remembers
from renet.errors import RenetError
from renet.interface import ACTION_SIZE, DEPTH_SHAPE, PROPRIOCEPTION_SIZE, STEPS_PER_TICK
from renet.selector.monitors import Gate


class EstimatorInput(NamedTuple):
    """What one 10 Hz tick of vision and of both estimators reads: copies, safe on any thread."""

    feed: dict[str, np.ndarray]
    """The estimators' inputs but for the images, by the names that their model gives them."""
    depth: np.ndarray
    """The two newest images that were delivered, [N, 2, 48, 64], newest first."""
    accepted: np.ndarray
    """The two newest images that VP was given before, likewise."""
    unpaired: np.ndarray
    """[N] bool: VP had no image a tick ago; the next one stands in for that one, too."""
    gate: Gate | None
    """Which images VP may use; None: all."""
    blind: bool
    """No image has arrived: vision does not run, and its scores are infinite."""

    def robots(self, rows: np.ndarray) -> "EstimatorInput":
        """What the tick of some robots reads, by their rows."""
        return EstimatorInput(
            {name: value[rows] for name, value in self.feed.items()},
            self.depth[rows],
            self.accepted[rows],
            self.unpaired[rows],
            None if self.gate is None else self.gate.of(rows),
            self.blind,
        )


EstimatorOutput = dict[str, np.ndarray]
"""What a tick found, by the names of `Policy`'s attributes that it replaces."""
ESTIMATES = ("latent_op", "latent_vp", "velocity_op", "velocity_vp", "feet_height", "height_map")
SCORES = ("anomaly_score", "variance_score")
OF_VP = ("latent_vp", "velocity_vp", "height_map", MAP_ERROR)
OF_OP = ("latent_op", "velocity_op")
"""What each estimator finds in a tick; a robot cannot walk on one that has found no numbers."""
LARGEST = 1e4
"""Beyond this a latent, m/s or m is no number either: an overflow on its way to infinity."""
SEEN = (*SCORES, "reconstruction")
"""Outputs of the vision model that are used, where it has them; a stranger's may have any others,
which must replace no attribute."""


def infer(sessions: Mapping[str, Session], inputs: EstimatorInput) -> EstimatorOutput:
    """One tick of vision and both estimators: a pure function, so that any thread may call it.

    Vision comes first, for it judges which images VP may use.
    """
    depth = inputs.depth
    unseen = np.inf if inputs.blind else 0.0
    result: dict[str, Any] = {name: np.full(len(depth), unseen, np.float32) for name in SCORES}
    if not inputs.blind:
        vision = sessions["vision"]
        names = [output.name for output in vision.get_outputs() if output.name in SEEN]
        result |= zip(names, vision.run(names, {"depth": depth}), strict=True)
        result |= {name: result[name].reshape(-1) for name in SCORES}
    estimator = sessions["estimator"]
    outputs = {name: f"next_{name}" if name.startswith("latent") else name for name in ESTIMATES}
    feed = inputs.feed | {"depth": depth}
    if remembers(estimator):
        has_image = np.full(len(depth), not inputs.blind)
        if inputs.gate is not None:
            has_image &= inputs.gate.judge(result)
        older = np.where(inputs.unpaired[:, None, None], depth[:, 0], inputs.accepted[:, 0])
        pair = np.stack((depth[:, 0], older), axis=1)
        accepted = np.where(has_image[:, None, None, None], pair, inputs.accepted)
        result |= {"has_image": has_image, "accepted": accepted}
        feed |= {"depth": accepted, HAS_IMAGE: has_image[:, None].astype(np.float32)}
    if MAP_ERROR in {output.name for output in estimator.get_outputs()}:
        outputs[MAP_ERROR] = MAP_ERROR
    result |= zip(outputs, estimator.run([*outputs.values()], feed), strict=True)
    return result


class Policy:
    """Runs a bundle at 50 Hz; every fifth step is a 10 Hz tick of the estimators and of vision.

    Mirrors training: after a reset latents are zero, the history is filled with the first o_t and
    both frames with the first image. Both estimators always run, so that a switch finds a warm
    state. A robot reset between ticks waits for the next one with zero latents.

    `step` does it all; a controller that ticks on another thread calls its parts.
    """

    def __init__(self, bundle: Bundle, num_robots: int = 1) -> None:
        self.manifest, self.sessions = bundle.manifest, bundle.sessions
        n = self.num_robots = num_robots
        shapes = model_shapes(self.manifest.history)
        inputs, estimates = shapes["estimator"]

        def zeros(shape: tuple[int, ...]) -> np.ndarray:
            return np.zeros((n, *shape), np.float32)

        self._history = zeros(inputs["proprioception_history"])
        """Oldest first."""
        self._frames = zeros(inputs["depth"])
        """Newest first."""
        self.latent_op, self.latent_vp = zeros(inputs["latent_op"]), zeros(inputs["latent_vp"])
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
        rows = slice(None) if mask is None else np.asarray(mask, bool)
        for name in ("latent_op", "latent_vp", MAP_ERROR, *SCORES):
            # Copies: a tick on another thread may still read the old arrays.
            value = getattr(self, name).copy()
            value[rows] = 0.0
            setattr(self, name, value)
        self.has_image = self.has_image.copy()
        self.has_image[rows] = True
        self.vp_lost[rows] = self.op_lost[rows] = False
        self._blank[rows] = self._fresh[rows] = True

    def retire(self, mask: np.ndarray) -> None:
        """Compute nothing more for the masked robots [N], until all are reset.

        Their actions in `step` are zero, and their estimates stay. Those of the other robots are
        the same, to the last digit, as beside them.
        """
        self._driven = np.flatnonzero(~mask)

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
            proprioception: o_t, [N, 45]. depth: newest image [N, 48, 64] in [0, 1], read at ticks;
            None without a camera. op_mask: [N] bool, the paper's mask: true where OP acts.
            gate: at ticks, which images VP may use; all by default.

        Returns:
            Actions [N, 12] in policy units, clipped as in training.

        Raises:
            RenetError: wrong shape, a number that is not finite, or depth outside [0, 1]. The
                memory is then unchanged.
        """
        proprioception = self._checked(proprioception, "proprioception", (PROPRIOCEPTION_SIZE,))
        if self.due and depth is not None:
            depth = self._checked(depth, "depth image", DEPTH_SHAPE)
            if depth.min() < 0.0 or depth.max() > 1.0:
                raise RenetError(
                    f"the depth image must be in [0, 1], not {depth.min():g} to {depth.max():g}:"
                    f" divide metres by {self.manifest.camera.range:g} and clip"
                )
        mask = np.ones(self.num_robots, bool) if depth is None else np.asarray(op_mask, bool)
        self.remember(proprioception)
        if self.due:
            inputs = self.look(depth, gate)
            if self._driven is None:
                self.accept(infer(self.sessions, inputs))
            else:
                self._accept_driven(infer(self.sessions, inputs.robots(self._driven)))
        return self.act(proprioception, mask | self.vp_lost)

    def remember(self, proprioception: np.ndarray) -> None:
        """Push o_t [N, 45] onto the history."""
        self._history[:, :-1] = self._history[:, 1:]
        self._history[:, -1] = proprioception
        if self._blank.any():
            self._history[self._blank] = proprioception[self._blank, None]
            self._blank[:] = False

    def look(self, depth: np.ndarray | None, gate: Gate | None = None) -> EstimatorInput:
        """Push an image [N, 48, 64], if there is one; returns what `infer` needs."""
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
        images = self._frames.copy(), self.accepted
        return EstimatorInput(feed, *images, unpaired, gate, blind=depth is None)

    def accept(self, result: EstimatorOutput) -> None:
        """Take over the output of a tick."""
        for name, value in result.items():
            setattr(self, name, value)
        self._find_lost(result)

    def _accept_driven(self, result: EstimatorOutput) -> None:
        """Take over the output of a tick of the robots that have not retired."""
        for name, value in result.items():
            # A copy, as in `reset`.
            whole = getattr(self, name).copy()
            whole[self._driven] = value
            setattr(self, name, whole)
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

    def act(self, proprioception: np.ndarray, op_mask: np.ndarray) -> np.ndarray:
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

    def joint_target(self, action: np.ndarray) -> np.ndarray:
        """Joint positions [N, 12] in rad that an action asks for."""
        robot = self.manifest.robot
        return robot.arrays["default_position"] + robot.action_scale * action

    def _checked(self, value: np.ndarray, name: str, shape: tuple[int, ...]) -> np.ndarray:
        value = np.asarray(value, np.float32)
        expected = (self.num_robots, *shape)
        if value.shape != expected:
            raise RenetError(f"the {name} has shape {value.shape}, expected {expected}")
        if not np.isfinite(value).all():
            raise RenetError(f"the {name} contains NaN or infinity")
        return value
