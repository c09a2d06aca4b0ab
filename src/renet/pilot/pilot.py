"""Pilot of N robots: choice of the estimator that drives, and joint targets.

A control step, 50 times a second, consists of:

1. `act`. Every fifth step is a tick, 10 times a second: monitors judge the newest image, the gate
   withholds a bad one, and vision and both estimators run. In every step the actor runs on the
   latent of the estimator that drives: that of VP, which uses the camera or its memory of the
   ground, or that of OP, which is blind.
2. `judge`. Monitors and filter decide which estimator drives the next step.

The mode of a robot says how this is decided:

| mode | VP drives | images |
|---|---|---|
| memory | while it sees or remembers the ground well enough | bad ones are withheld |
| switch | while the reconstruction loss is low (the paper's switch) | all are used |
| camera | always | all are used |
| blind | never | none is used |
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol, Self, get_args

import numpy as np

from renet.bundle import Bundle
from renet.errors import RenetError, demand_name
from renet.interface import (
    DEPTH_SHAPE,
    PROPRIOCEPTION,
    PROPRIOCEPTION_SIZE,
    STEPS_PER_TICK,
    PilotMode,
    Unseen,
    proprioception_slices,
)
from renet.pilot.images import ImageHolder, Images
from renet.pilot.policy import BundlePolicy, Policy, checked, checked_depth
from renet.pilot.reach import (
    MAP_POINTS,
    SPEEDS,
    STOPPING_MARGIN,
    UNSEEN,
    Reach,
    can_stop,
    direction_of,
    slowed,
    stands_on_level_ground,
)
from renet.selector import make_selector
from renet.selector.monitors import Gate, SelectorInput
from renet.selector.selector import BLIND, SEES, SELECTORS

PILOT_MODES = get_args(PilotMode)
COMMAND_SLICE = proprioception_slices()["command"]
"""Slice of the command in an observation."""
TURN_RATE = proprioception_slices()["base_angular_velocity"].stop - 1
"""Index of the base's turn rate in an observation."""
TURN_RATE_SCALE = PROPRIOCEPTION[0].scale
"""Scale of the turn rate in an observation."""
NO_NUMBERS = "what the VP estimator found is not finite"
"""Reason of a robot whose VP has results that are not finite."""
NO_IMAGE = "no image has come yet"
"""Reason of a robot that has never had an image."""
BEGAN_WITHOUT = "it began without an image"
"""Reason of a robot that has images now, and has not seen since it began without."""
USES_NONE = "the mode blind uses no images"
"""Reason of a robot in the mode blind."""
BEYOND = "it stands beyond the ground that it has seen"
"""Reason of a robot that has stopped there."""


@dataclass(frozen=True)
class Step:
    """Results of one control step."""

    joint_target: np.ndarray
    """Joint targets in the order of `interface.JOINTS`, [N, 12] rad."""
    action: np.ndarray
    """Actions in policy units, [N, 12]; the next observation holds them as the last action."""
    vision: np.ndarray
    """True where VP drove this step, [N] bool."""
    state: np.ndarray
    """State of each robot from now on, [N]: `sees`, `remembers` (VP drives without images) or
    `blind` (OP drives)."""
    reason: np.ndarray
    """Reason why each robot does not see, [N] text: that of the first monitor that objected since
    it saw, or why it was blind from the first step on. Empty while it sees."""
    unseen: np.ndarray
    """True where the command leads to ground that the robot has not seen, [N] bool."""
    inferred: bool
    """True if this step received the result of a tick."""
    fallback: bool
    """True if the tick of this step ran in line without an image, because the one before was
    late."""


class Selector(Protocol):
    """Interface of selectors, such as `renet.selector.selector.MonitorSelector`."""

    @property
    def probability(self) -> np.ndarray:
        """Vision probability P_t, [N]."""
        ...

    def look(self, seen: SelectorInput) -> Gate:
        """Judge the images of a tick before vision runs; returns the gate on VP's images."""
        ...

    def update(self, seen: SelectorInput, now: float) -> np.ndarray:
        """Return a mask of robots that VP may drive, [N] bool, at the time `now`, s."""
        ...

    def distrust(self, mask: np.ndarray, reason: str) -> None:
        """Let OP drive the masked robots, [N] bool, at once, for a reason."""

    def reset(self, mask: np.ndarray | None = None) -> None:
        """Trust vision and forget the past of the masked robots, [N] bool, by default of all."""


class Pilot:
    """Pilot of N robots with one policy, each in a mode of its own."""

    def __init__(
        self,
        policy: Policy,
        selectors: Mapping[str, Selector],
        modes: Sequence[str],
        unseen: Unseen | Sequence[Unseen] = "walk",
    ) -> None:
        """Combine a policy and selectors.

        Args:
            policy: Policy of N robots.
            selectors: Selectors of N robots by the mode that obeys them, `memory` or `switch`.
                Robots in other modes obey none; their `probability` and `trusted` are those of the
                mode `memory`.
            modes: Mode of each robot, one of `PILOT_MODES`.
            unseen: Conduct of robots in the mode `memory` at the end of the ground that they have
                seen: one of `UNSEEN` for all robots, or one for each.

        Raises:
            RenetError: A mode or conduct is unknown, or there are not as many conducts as robots.
        """
        for mode in dict.fromkeys(modes):
            demand_name("mode", mode, PILOT_MODES)
        robots = len(modes)
        self.num_robots = robots
        self.policy = policy
        self.selectors = selectors
        self.modes = np.array(modes)
        """Mode of each robot, [N]."""
        self.vision = np.ones(robots, bool)
        """True where VP drove the newest step, [N] bool."""
        self.trusted = np.ones(robots, bool)
        """True where a robot's selector lets VP drive the next step, [N] bool."""
        self._obeys = np.isin(self.modes, SELECTORS)
        self._always = self.modes == "camera"
        self._image = np.zeros((robots, *DEPTH_SHAPE), np.float32)
        """Images of the newest tick, [N, 48, 64]."""
        self._arrived = np.zeros(robots, bool)
        """True where an image has arrived since the newest tick, [N] bool."""
        self._camera = ImageHolder(robots)
        self._steps = 0
        self._imageless = np.zeros(robots, bool)
        """True where a robot has not seen since it began without an image, [N] bool."""
        self._now = -math.inf
        """Time of the newest `step`, s."""
        self.command = np.zeros((robots, 3))
        """Command that the policy was told in the newest step, slowed in front of unseen ground,
        [N, 3]."""

        # Conduct at the end of the ground that robots have seen.
        conducts = [unseen] * robots if isinstance(unseen, str) else list(unseen)
        if len(conducts) != robots:
            raise RenetError(f"{len(conducts)} conducts for {robots} robots: give one, or one each")
        for conduct in dict.fromkeys(conducts):
            demand_name("unseen", conduct, UNSEEN)
        self._fastest = np.array([SPEEDS[conduct] for conduct in conducts])
        """Largest speed towards unseen ground, [N] m/s."""
        self.reach = Reach(robots)
        self.unseen = np.zeros(robots, bool)
        """True where the command leads to ground that the robot has not seen, [N] bool."""
        self._halted = np.zeros(robots, bool)
        """True where a robot has stopped at the end of the ground that it has seen, [N] bool."""
        self._beyond = np.zeros(robots, bool)
        """True where such a robot is on level ground beyond what it saw: OP drives it, [N] bool."""

    @classmethod
    def of(
        cls,
        bundle: Bundle,
        robots: int = 1,
        mode: str | Sequence[str] = "memory",
        policy: BundlePolicy | None = None,
        unseen: Unseen = "walk",
    ) -> Self:
        """Build a pilot with the policy and selectors of a bundle.

        Args:
            bundle: The bundle.
            robots: Number of robots, N.
            mode: One of `PILOT_MODES` for all robots, or one for each.
            policy: Policy of the bundle for N robots; by default one whose ticks run in line.
            unseen: Conduct of robots in the mode `memory` at the end of the ground that they have
                seen: `walk` on, `slow` down or `stop`.

        Raises:
            RenetError: There are no robots, a mode or conduct is unknown, or there are not as many
                modes as robots.
        """
        if robots < 1:
            raise RenetError(f"robots must be at least 1, got {robots}")
        modes = [mode] * robots if isinstance(mode, str) else list(mode)
        if len(modes) != robots:
            raise RenetError(f"{len(modes)} modes for {robots} robots: give one, or one for each")
        needed = [kind for kind in SELECTORS if kind in modes] or ["memory"]
        spec = bundle.manifest.selector
        selectors = {kind: make_selector(kind, spec, robots) for kind in needed}
        policy = policy or BundlePolicy(bundle, robots)
        return cls(policy, selectors, modes, unseen)

    def step(self, observation: np.ndarray, image: np.ndarray | Images | None, now: float) -> Step:
        """Take one control step, to be called every 0.02 s, with the policy of a bundle.

        Args:
            observation: Observation o_t, [N, 45], with the terms of `interface.PROPRIOCEPTION`.
            image: Depth images that have just been taken, [N, 48, 64] in [0, 1]; None if no new one
                has arrived since the last step, or without a camera. `Images` also hold ages and
                other facts of the images.
            now: Time on any clock, s. While it stands still, nothing is judged.

        Raises:
            RenetError: An input has another shape, is not finite, depth is outside [0, 1], or time
                runs backwards without a `reset` of all robots. The pilot is then unchanged.
        """
        policy: Any = self.policy
        self._check_time(now)
        observation = checked(observation, "observation", (self.num_robots, PROPRIOCEPTION_SIZE))
        images = image if isinstance(image, Images) else self._hold(image, now)
        # A tick judges the images before the policy checks them.
        if self.due and images.image is not None:
            checked_depth(images.image, self.num_robots, policy.manifest.camera.range)
        self._now = now
        tick = self.due
        action = self.act(observation, images)
        self.judge(self.seen(images), now)
        state = self._state(images)
        return Step(
            joint_target=policy.joint_target(action),
            action=action,
            vision=self.vision,
            state=state,
            reason=self._reason(images, state),
            unseen=self.unseen,
            inferred=policy.inferred,
            fallback=tick and policy.fallback,
        )

    def reset(self, mask: np.ndarray | None = None) -> None:
        """Forget the past of the masked robots, [N] bool, and trust vision; by default of all.

        A reset of all robots also restarts the 10 Hz clock and forgets the images and the time.
        """
        if mask is None:
            self._steps = 0
            self._now = -math.inf
            self._camera = ImageHolder(self.num_robots)
        self.policy.reset(mask)
        for selector in self.selectors.values():
            selector.reset(mask)
        robots = np.ones(self.num_robots, bool) if mask is None else np.asarray(mask, bool)
        self.trusted = self.trusted | robots
        self._arrived = self._arrived & ~robots
        self._imageless = self._imageless & ~robots
        self.reach.reset(robots)
        self.unseen = self.unseen & ~robots
        self._halted = self._halted & ~robots
        self._beyond = self._beyond & ~robots

    @property
    def due(self) -> bool:
        """True if the next step is a tick."""
        return self._steps % STEPS_PER_TICK == 0

    @property
    def probability(self) -> np.ndarray:
        """Vision probability P_t, [N]."""
        return self._obeyed("probability")

    @property
    def without_image(self) -> np.ndarray:
        """Time since VP's newest tick with an image, [N] s; infinite before the first."""
        return self._obeyed("without_image")

    @property
    def map_seen(self) -> np.ndarray:
        """True where VP's height map shows ground that the robot has seen, [N, 132] bool."""
        seen = self.reach.covers(MAP_POINTS)
        # An image of the newest tick becomes the origin of the reach in the next step.
        has_image = getattr(self.policy, "has_image", np.ones(self.num_robots, bool))
        return seen | has_image[:, None]

    # Parts of `step`, for rollouts that judge more often than they act.

    def act(
        self, observation: np.ndarray, images: Images, distrusted: np.ndarray | None = None
    ) -> np.ndarray:
        """Compute the actions of one control step, [N, 12].

        Args:
            observation: Observation o_t, [N, 45].
            images: Images delivered so far.
            distrusted: True for robots that OP drives in this step in any mode, [N] bool.
        """
        # At a tick the selectors decide which images VP may use.
        self._arrived = self._arrived | images.fresh
        gate = self._look(images) if self.due else None

        # Robots that VP drives in this step.
        vision = np.where(self._obeys, self.trusted, self._always)
        if images.image is None:
            vision = np.zeros(self.num_robots, bool)
        if distrusted is not None:
            vision = vision & ~distrusted
        self._steps += 1
        policy: Any = self.policy
        observation = self._heed_unseen(observation)
        # VP imagines ground that it never saw, and robots that are told to stand leap over it.
        vision = vision & ~self._beyond
        self.command = observation[:, COMMAND_SLICE]
        gated = () if gate is None else (gate,)
        action = policy.step(observation, images.image, ~vision, *gated)

        # Where VP's results are not finite, the policy has let OP drive.
        lost = getattr(policy, "vp_lost", np.zeros(self.num_robots, bool))
        if lost.any():
            for selector in self.selectors.values():
                selector.distrust(lost, NO_NUMBERS)
        self.vision = vision & ~lost
        return action

    def judge(self, seen: SelectorInput, now: float) -> None:
        """Decide which robots VP may drive in the next step.

        Args:
            seen: Input of the selectors.
            now: Time on the same clock as before, s.
        """
        answers = {}
        for kind, selector in self.selectors.items():
            answers[kind] = selector.update(seen, now)
        self.trusted = self._of_each(answers)

    def seen(self, images: Images, fresh: np.ndarray | None = None) -> SelectorInput:
        """Collect the input of the selectors: the images, and the policy's scores of them.

        Args:
            images: Images delivered so far.
            fresh: True for images that no selector has looked at yet, [N] bool; by default none.
        """
        policy = self.policy
        zero = np.zeros(self.num_robots)
        still = np.zeros((self.num_robots, 3))
        return SelectorInput(
            anomaly_score=np.where(images.broken, np.inf, policy.anomaly_score),
            image=self._image,
            fresh=np.zeros(self.num_robots, bool) if fresh is None else fresh,
            age=images.age,
            invalid=images.invalid,
            # Attributes that a policy of another project may lack.
            velocity_op=getattr(policy, "velocity_op", still),
            velocity_vp=getattr(policy, "velocity_vp", still),
            variance_score=getattr(policy, "variance_score", zero),
            surprise=getattr(policy, "surprise", zero),
            stillness=getattr(policy, "stillness", zero),
            has_image=getattr(policy, "has_image", zero == 0.0),
            map_error=getattr(policy, "map_error", zero),
            scored=getattr(policy, "inferred", True),
        )

    def _heed_unseen(self, observation: np.ndarray) -> np.ndarray:
        """Slow down or stop robots in front of ground that they have not seen.

        Args:
            observation: Observation o_t, [N, 45].

        Returns:
            The observation, with limited commands, [N, 45].
        """
        # Policies of other projects do not say what they remember.
        manifest = getattr(self.policy, "manifest", None)
        if manifest is None or not hasattr(self.policy, "has_image"):
            return observation

        # Move on from the last image; one that VP has just used is the new origin.
        policy: Any = self.policy
        self.reach.move(policy.velocity_vp[:, :2], observation[:, TURN_RATE] / TURN_RATE_SCALE)
        remembers = ~policy.has_image & (self.modes == "memory")
        self.reach.reset(~remembers)
        self.reach.forget(remembers & np.isnan(policy.image_age))

        # Robots whose command leads to the end of the ground that they have seen.
        command = observation[:, COMMAND_SLICE]
        ahead = self.reach.ahead(direction_of(command, manifest.told))
        self.unseen = ahead < STOPPING_MARGIN
        at_end = can_stop(ahead, policy.height_map)
        self._halt(at_end & (self._fastest == 0.0), ahead)
        if not self.unseen.any() or np.isinf(self._fastest).all():
            return observation
        limit = np.where(at_end | self._halted, self._fastest, np.inf)
        observation = observation.copy()
        observation[:, COMMAND_SLICE] = slowed(command, manifest.told, limit)
        return observation

    def _halt(self, stops: np.ndarray, ahead: np.ndarray) -> None:
        """Keep which robots have stopped at the end of the ground seen, and which are beyond it.

        A robot that has stopped stays, whatever VP imagines later, until it sees again or its
        command leads elsewhere.

        Args:
            stops: True for robots that are at that end and have to stop, [N] bool.
            ahead: Distance to that end, [N] m (see `Reach.ahead`).
        """
        policy: Any = self.policy
        stops = stops & ~self._halted
        # A robot that has seen no ground is not beyond any: OP drives it for its own reason.
        past = (ahead < 0.0) & self.reach.seen
        beyond = stops & past & stands_on_level_ground(policy.height_map)
        self._halted = (self._halted & self.unseen) | stops
        self._beyond = (self._beyond & self.unseen) | beyond

    def _check_time(self, now: float) -> None:
        """Raise RenetError unless time is finite, and not before that of the newest step."""
        if not math.isfinite(now):
            raise RenetError(f"the time now is {now}, expected a finite number of seconds")
        if now < self._now:
            raise RenetError(
                f"the time now is {now:.3f} s, expected at least the {self._now:.3f} s of the step"
                " before: use one clock, and reset() the pilot where it begins anew"
            )

    def _hold(self, image: np.ndarray | None, now: float) -> Images:
        """Check and keep images [N, 48, 64] that have just been taken, if there are any."""
        if image is not None:
            policy: Any = self.policy
            image = checked_depth(image, self.num_robots, policy.manifest.camera.range)
            # In half precision, as in training.
            image = image.astype(np.float16).astype(np.float32)
        return self._camera.hold(image, now)

    def _look(self, images: Images) -> Gate | None:
        """Let the selectors look at the images of a tick.

        Returns:
            Gate that withholds images from robots in the mode `memory`; None for a policy that
            cannot do without an image.
        """
        if images.image is not None:
            self._image = images.image
        seen = self.seen(images, fresh=self._arrived)
        self._arrived = np.zeros(self.num_robots, bool)
        gates = {kind: selector.look(seen) for kind, selector in self.selectors.items()}
        if not hasattr(self.policy, "has_image"):
            return None
        # Any gate tells which images are new; that of a memory comes first.
        gate = next(iter(gates.values()))
        return replace(gate, robots=self.modes == "memory")

    def _state(self, images: Images) -> np.ndarray:
        """Return the state of each robot, [N]: sees, remembers or blind."""
        # Before the first image OP drives all robots, also those that their selector still trusts.
        if images.image is None:
            return np.full(self.num_robots, BLIND)
        # Robots in the modes camera and blind obey no selector.
        disobedient = np.where(self._always, SEES, BLIND)
        state = np.where(self._obeys, self._obeyed("state"), disobedient)
        return np.where(self._beyond, BLIND, state)

    def _reason(self, images: Images, state: np.ndarray) -> np.ndarray:
        """Return the reason why each robot is not in the state `sees`, [N] text."""
        if images.image is None:
            self._imageless[:] = True
            beginning = NO_IMAGE
        else:
            self._imageless = self._imageless & (state != SEES)
            beginning = BEGAN_WITHOUT
        reason = np.where(self._obeys, self._obeyed("reason"), "")
        reason = np.where(self._imageless, beginning, reason)
        reason = np.where(self._beyond, BEYOND, reason)
        return np.where(self.modes == "blind", USES_NONE, reason)

    def _obeyed(self, attribute: str) -> np.ndarray:
        """Return an attribute, [N], of the selector that each robot obeys."""
        values = {}
        for kind, selector in self.selectors.items():
            values[kind] = getattr(selector, attribute)
        return self._of_each(values)

    def _of_each(self, values: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return the value of each robot's own selector, [N], from values [N] by selector."""
        if len(values) == 1:
            (value,) = values.values()
            return value
        return np.where(self.modes == "switch", values["switch"], values["memory"])
