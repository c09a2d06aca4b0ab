"""The pilot of one robot or N: which estimator drives, and where to each joint is to go.

One control step, 50 times a second, is:

1. `act`. Every fifth step is a tick, 10 times a second: the monitors look at the newest image and
   the gate withholds a bad one, then vision and both estimators run. In every step the actor runs
   on the latent of the estimator that drives: VP's, which uses the camera or its memory of the
   ground, or OP's, which does not.
2. `judge`. Monitors and filter decide which estimator drives the next step.

The mode of a robot says who decides:

| mode | VP drives | images |
|---|---|---|
| memory | while it sees or remembers the ground well enough | bad ones are withheld |
| switch | while the reconstruction loss is low (the paper's switch) | all are used |
| camera | always | all are used |
| blind | never | none is used |
"""

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
from renet.pilot.reach import MARGIN, SPEEDS, UNSEEN, Reach, can_stop, direction_of, slowed
from renet.selector import make_selector
from renet.selector.monitors import Gate, SelectorInput
from renet.selector.selector import BLIND, SEES, SELECTORS

PILOT_MODES = get_args(PilotMode)
COMMAND = proprioception_slices()["command"]
TURN_RATE = proprioception_slices()["base_angular_velocity"].stop - 1
"""Place of the base's turn rate in an observation."""
TURN_RATE_SCALE = PROPRIOCEPTION[0].scale
NO_NUMBERS = "what the VP estimator found is not finite"


@dataclass(frozen=True)
class Step:
    """Results of one control step."""

    joint_target: np.ndarray
    """[N, 12] rad, in the order of `interface.JOINTS`."""
    action: np.ndarray
    """[N, 12] policy units; the next observation holds it as the last action."""
    vision: np.ndarray
    """[N] bool: VP drove this step."""
    state: np.ndarray
    """[N] `sees`, `remembers` (VP drives without images) or `blind` (OP drives), from now on."""
    reason: np.ndarray
    """[N] objection of the first monitor since the robot saw, in words; empty while it sees."""
    unseen: np.ndarray
    """[N] bool: the ground that the robot is told to walk on next lies beyond what it has seen."""
    inferred: bool
    """The result of a tick of vision was taken over in this step."""
    fallback: bool
    """The tick of this step ran blind and in line, because the one before was late."""


class Selector(Protocol):
    """Judges the vision of N robots: `renet.selector.selector.MonitorSelector` is one."""

    @property
    def probability(self) -> np.ndarray:
        """Vision probability P_t, [N]."""
        ...

    def look(self, seen: SelectorInput) -> Gate | None:
        """Judge the images of a tick before vision runs; None: VP may use all of them."""
        ...

    def update(self, seen: SelectorInput, now: float) -> np.ndarray:
        """Whether VP may drive, [N] bool, by what is known of vision `now`, s."""
        ...

    def distrust(self, mask: np.ndarray, reason: str) -> None:
        """Let OP drive the masked robots [N] at once, for a reason."""

    def reset(self, mask: np.ndarray | None = None) -> None:
        """Trust vision and forget the past of the masked robots [N], of all by default."""


class Pilot:
    """Drives N robots, each in its mode, with one policy."""

    def __init__(
        self,
        policy: Policy,
        selectors: Mapping[str, Selector],
        modes: Sequence[str],
        unseen: Unseen | Sequence[Unseen] = "walk",
    ) -> None:
        """Combine a policy and selectors.

        Args:
            policy: of N robots.
            selectors: of N robots, by the mode that obeys it, `memory` or `switch`. Robots of the
                other modes obey none; in `probability` and `trusted` they have those of `memory`.
            modes: of each robot, one of `PILOT_MODES`.
            unseen: what robots of the mode `memory` do at the end of the ground that they have
                seen, one of `UNSEEN` for all robots, or N of them.

        Raises:
            RenetError: unknown mode or conduct, or another number of conducts than of robots.
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
        """Whether VP drove the newest step, [N]."""
        self.trusted = np.ones(robots, bool)
        """Whether VP may drive the next step, [N], by the selector of each robot."""
        self._obeys = np.isin(self.modes, SELECTORS)
        self._always = self.modes == "camera"
        self._image = np.zeros((robots, *DEPTH_SHAPE), np.float32)
        """Image of the newest tick."""
        self._arrived = np.zeros(robots, bool)
        """Whether an image has arrived since the newest tick, [N]."""
        self._camera = ImageHolder(robots)
        self._steps = 0
        conducts = [unseen] * robots if isinstance(unseen, str) else list(unseen)
        if len(conducts) != robots:
            raise RenetError(f"{len(conducts)} conducts for {robots} robots: give one, or one each")
        for conduct in dict.fromkeys(conducts):
            demand_name("unseen", conduct, UNSEEN)
        self._fastest = np.array([SPEEDS[conduct] for conduct in conducts])
        """Fastest walk towards unseen ground, [N] m/s."""
        self.reach = Reach(robots)
        self.unseen = np.zeros(robots, bool)
        """Whether the ground ahead of a robot lies beyond what it has seen, [N]."""

    @classmethod
    def of(
        cls,
        bundle: Bundle,
        robots: int = 1,
        mode: str | Sequence[str] = "memory",
        policy: BundlePolicy | None = None,
        unseen: Unseen = "walk",
    ) -> Self:
        """A pilot with the selectors of a bundle.

        Args:
            bundle: loaded.
            robots: number of robots, N.
            mode: one of `PILOT_MODES` for all robots, or N of them.
            policy: of the bundle for N robots; by default one whose ticks run in line.
            unseen: what robots of the mode `memory` do at the end of the ground that they have
                seen: `walk` on, `slow` down or `stop`.

        Raises:
            RenetError: no robot, an unknown mode or conduct, or not as many modes as robots.
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
        """One control step, every 0.02 s, with the policy of a bundle.

        Args:
            observation: o_t, [N, 45], the terms of `interface.PROPRIOCEPTION` in their order.
            image: depth images [N, 48, 64] in [0, 1] that have just been taken; None if no new one
                has arrived since the last step, or without a camera. `Images` tell more.
            now: seconds on any clock; while it stands or runs backwards nothing is judged.

        Raises:
            RenetError: wrong shape, a number that is not finite, or depth outside [0, 1]; the pilot
                is then unchanged.
        """
        policy: Any = self.policy
        observation = checked(observation, "observation", (self.num_robots, PROPRIOCEPTION_SIZE))
        images = image if isinstance(image, Images) else self._hold(image, now)
        tick = self.due
        action = self.act(observation, images)
        self.judge(self.seen(images), now)
        return Step(
            joint_target=policy.joint_target(action),
            action=action,
            vision=self.vision,
            state=self._state(images),
            reason=np.where(self._obeys, self._obeyed("reason"), ""),
            unseen=self.unseen,
            inferred=policy.inferred,
            fallback=tick and policy.fallback,
        )

    def reset(self, mask: np.ndarray | None = None) -> None:
        """Begin anew with the masked robots [N], trusting vision; by default with all.

        Resetting all restarts the 10 Hz clock and forgets their images.
        """
        if mask is None:
            self._steps = 0
            self._camera = ImageHolder(self.num_robots)
        self.policy.reset(mask)
        for selector in self.selectors.values():
            selector.reset(mask)
        robots = np.ones(self.num_robots, bool) if mask is None else np.asarray(mask, bool)
        self.trusted = self.trusted | robots
        self._arrived = self._arrived & ~robots
        self.reach.reset(robots)
        self.unseen = self.unseen & ~robots

    @property
    def due(self) -> bool:
        """Whether the next step is a tick."""
        return self._steps % STEPS_PER_TICK == 0

    @property
    def probability(self) -> np.ndarray:
        """Vision probability P_t, [N]."""
        return self._obeyed("probability")

    @property
    def without_image(self) -> np.ndarray:
        """Seconds since VP's newest tick with an image, [N]; infinite before the first."""
        return self._obeyed("without_image")

    # The parts of `step`, for rollouts, which judge more often than they act.

    def act(
        self, observation: np.ndarray, images: Images, distrusted: np.ndarray | None = None
    ) -> np.ndarray:
        """Actions [N, 12] of one control step.

        Args:
            observation: o_t, [N, 45].
            images: delivered by now.
            distrusted: [N] bool, robots that OP drives in this step, whatever their mode.
        """
        self._arrived = self._arrived | images.fresh
        gate = self._look(images) if self.due else None
        vision = np.where(self._obeys, self.trusted, self._always)
        if images.image is None:
            vision = np.zeros(self.num_robots, bool)
        if distrusted is not None:
            vision = vision & ~distrusted
        self._steps += 1
        policy: Any = self.policy
        observation = self._heed_unseen(observation)
        gated = () if gate is None else (gate,)
        action = policy.step(observation, images.image, ~vision, *gated)
        # Where VP found no numbers, the policy has let OP drive.
        lost = getattr(policy, "vp_lost", np.zeros(self.num_robots, bool))
        if lost.any():
            for selector in self.selectors.values():
                selector.distrust(lost, NO_NUMBERS)
        self.vision = vision & ~lost
        return action

    def judge(self, seen: SelectorInput, now: float) -> None:
        """Decide by what is known of vision `now`, s, whether VP may drive the next step."""
        answers = {kind: one.update(seen, now) for kind, one in self.selectors.items()}
        self.trusted = self._of_each(answers)

    def seen(self, images: Images, fresh: np.ndarray | None = None) -> SelectorInput:
        """The input of the selectors: the images, and what the policy says of them.

        Args:
            images: delivered by now.
            fresh: [N] bool, those that no selector has looked at yet; by default none.
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
            # Policies of others may lack these.
            velocity_op=getattr(policy, "velocity_op", still),
            velocity_vp=getattr(policy, "velocity_vp", still),
            variance_score=getattr(policy, "variance_score", zero),
            has_image=getattr(policy, "has_image", zero == 0.0),
            map_error=getattr(policy, "map_error", zero),
        )

    def _heed_unseen(self, observation: np.ndarray) -> np.ndarray:
        """Slow down or stop robots before ground that they have not seen.

        Args:
            observation: o_t, [N, 45].

        Returns:
            o_t with the commands that the policy is told, [N, 45].
        """
        manifest = getattr(self.policy, "manifest", None)
        if manifest is None or not hasattr(self.policy, "has_image"):
            # Policies of others do not say what they remember.
            return observation
        policy: Any = self.policy
        self.reach.move(policy.velocity_vp[:, :2], observation[:, TURN_RATE] / TURN_RATE_SCALE)
        self.reach.reset(policy.has_image | (self.modes != "memory"))
        command = observation[:, COMMAND]
        way = direction_of(command, manifest.told)
        ahead = self.reach.ahead(way)
        self.unseen = ahead < MARGIN
        if not self.unseen.any() or np.isinf(self._fastest).all():
            return observation
        limit = np.where(can_stop(ahead, policy.height_map), self._fastest, np.inf)
        observation = observation.copy()
        observation[:, COMMAND] = slowed(command, manifest.told, limit)
        return observation

    def _hold(self, image: np.ndarray | None, now: float) -> Images:
        """Check and keep images [N, 48, 64] that have just been taken, if there are any."""
        if image is not None:
            policy: Any = self.policy
            image = checked_depth(image, self.num_robots, policy.manifest.camera.range)
            # Half precision, in which training saw them.
            image = image.astype(np.float16).astype(np.float32)
        return self._camera.hold(image, now)

    def _look(self, images: Images) -> Gate | None:
        """Let the selectors look at the images of a tick; returns which of them VP may use."""
        if images.image is not None:
            self._image = images.image
        seen = self.seen(images, fresh=self._arrived)
        self._arrived = np.zeros(self.num_robots, bool)
        gates = {kind: selector.look(seen) for kind, selector in self.selectors.items()}
        gate = gates.get("memory")
        if gate is None or not hasattr(self.policy, "has_image"):
            return None
        return replace(gate, robots=self.modes == "memory")

    def _state(self, images: Images) -> np.ndarray:
        """Whether each robot sees, remembers or is blind, [N]."""
        always = SEES if images.image is not None else BLIND
        disobedient = np.where(self._always, always, BLIND)
        return np.where(self._obeys, self._obeyed("state"), disobedient)

    def _obeyed(self, attribute: str) -> np.ndarray:
        """An attribute [N] of the selector that each robot obeys."""
        return self._of_each({kind: getattr(s, attribute) for kind, s in self.selectors.items()})

    def _of_each(self, values: Mapping[str, np.ndarray]) -> np.ndarray:
        """Of values [N] by selector, each robot's own."""
        if len(values) == 1:
            (value,) = values.values()
            return value
        return np.where(self.modes == "switch", values["switch"], values["memory"])
