"""Learned switches between vision and blindness, as selectors beside RENet's.

- `ReturnSwitch` after VB-Com (Ren et al. 2025, arXiv 2502.14814): one estimator of the return for
  each mode; the mode with the higher one acts. Here both modes are RENet's estimators under one
  actor, where VB-Com has two policies.
- `Gate`: a classifier trained on which cameras were failing.

Both read what the robot has at 50 Hz: proprioception, both latents and the anomaly score.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy import special
from torch import Tensor, nn

from renet.errors import RenetError
from renet.evaluation.evaluator import Evaluator
from renet.evaluation.results import Provenance
from renet.evaluation.rollout import EvalEnv, Trial
from renet.interface import LATENT, PROPRIOCEPTION_SIZE
from renet.models.actor_critic import mlp
from renet.pilot.pilot import Selector
from renet.pilot.policy import BundlePolicy
from renet.selector import SelectorInput
from renet.selector.monitors import Gate as ImageGate
from renet.training.np3o import advantages

BLIND = PROPRIOCEPTION_SIZE + LATENT
"""Leading inputs that do not come from the camera: o_t and h_b."""
INPUTS = BLIND + LATENT + 1
"""With h_v and the logarithm of the anomaly score."""


@dataclass(frozen=True)
class Experience:
    """Recorded walking: T control steps of N robots."""

    inputs: Tensor
    """[T, N, INPUTS]"""
    reward: Tensor
    """[T, N]"""
    done: Tensor
    """[T, N] bool: the episode ended with this step."""
    vision: Tensor
    """[T, N] bool: VP acted."""
    failing: Tensor
    """[T, N] bool: the camera was failing."""


class ReturnSwitch(nn.Module):
    """Estimators of the return under VP and under OP, as a mean reward."""

    def __init__(self, hidden: tuple[int, ...] = (128, 64)) -> None:
        super().__init__()
        self.vision = mlp((INPUTS, *hidden, 1))
        self.blind = mlp((BLIND, *hidden, 1))

    def preference(self, inputs: Tensor) -> Tensor:
        """Return under vision less that under blindness, [N]."""
        return (self.vision(inputs) - self.blind(inputs[..., :BLIND])).squeeze(-1)

    def loss(self, seen: Experience, returns: Tensor) -> Tensor:
        """Squared error of each estimator where its own mode acted."""
        expected = torch.where(
            seen.vision,
            self.vision(seen.inputs).squeeze(-1),
            self.blind(seen.inputs[..., :BLIND]).squeeze(-1),
        )
        return (expected - returns).square().mean()


class Gate(nn.Module):
    """Classifies healthy cameras; its logit is the preference."""

    def __init__(self, hidden: tuple[int, ...] = (128, 64)) -> None:
        super().__init__()
        self.healthy = mlp((INPUTS, *hidden, 1))

    def preference(self, inputs: Tensor) -> Tensor:
        """Log odds that the camera is healthy, [N]."""
        return self.healthy(inputs).squeeze(-1)

    def loss(self, seen: Experience, returns: Tensor) -> Tensor:
        """Cross-entropy against the cameras' true state."""
        del returns
        truth = (~seen.failing).float()
        return nn.functional.binary_cross_entropy_with_logits(self.preference(seen.inputs), truth)


def fit(
    switch: ReturnSwitch | Gate,
    seen: Experience,
    gamma: float = 0.98,
    horizon: int = 150,
    epochs: int = 200,
    rate: float = 1e-3,
) -> list[float]:
    """Train a switch on experience; returns the loss of every epoch.

    Args:
        switch: changed in place.
        seen: experience, of whose last `horizon` steps only the rewards count.
        gamma: discount of the return per control step.
        horizon: steps after which rewards hardly count.
        epochs: passes. rate: Adam's.

    Raises:
        RenetError: too little experience for the horizon, or only one mode or camera state in it.
    """
    usable = len(seen.reward) - horizon
    if usable < 1:
        raise RenetError(f"{len(seen.reward)} steps are too few for a horizon of {horizon}")
    flags = seen.vision if isinstance(switch, ReturnSwitch) else seen.failing
    if flags.all() or not flags.any():
        what = "VP and OP" if isinstance(switch, ReturnSwitch) else "healthy and failing cameras"
        raise RenetError(f"experience must show both {what}")
    reward = seen.reward.unsqueeze(-1)
    nothing = torch.zeros_like(reward)
    # Without values and with lambda 1 these are returns. Scaled to a mean reward: sums of many
    # steps would take long to learn.
    sums = advantages(reward, nothing, nothing[0], seen.done, gamma, lam=1.0)
    returns = (1.0 - gamma) * sums.squeeze(-1)[:usable]
    part = Experience(**{name: value[:usable] for name, value in vars(seen).items()})
    optimizer = torch.optim.Adam(switch.parameters(), rate)
    losses = []
    for _ in range(epochs):
        optimizer.zero_grad()
        loss = switch.loss(part, returns)
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    return losses


class ObservedPolicy(BundlePolicy):
    """The bundle's policy, which also keeps what a switch reads."""

    inputs: Tensor
    """[N, INPUTS] of the newest step."""

    def step(
        self,
        proprioception: np.ndarray,
        depth: np.ndarray | None,
        op_mask: np.ndarray,
        gate: ImageGate | None = None,
    ) -> np.ndarray:
        """Actions [N, 12]; see `BundlePolicy`."""
        action = super().step(proprioception, depth, op_mask, gate)
        score = np.log(np.clip(self.anomaly_score, 1e-9, 1e9))[:, None]
        parts = (proprioception, self.latent_op, self.latent_vp, score)
        self.inputs = torch.from_numpy(np.concatenate(parts, axis=1).astype(np.float32))
        return action


class SwitchSelector:
    """Obeys the sign of a switch's smoothed preference."""

    def __init__(
        self, switch: ReturnSwitch | Gate, policy: ObservedPolicy, smoothing: float = 0.02
    ) -> None:
        """Set up for the robots of a policy, all trusting vision.

        Args:
            switch: trained.
            policy: whose inputs it reads.
            smoothing: weight of a new preference in the moving average, per 200 Hz update.
        """
        self._switch, self._policy, self._smoothing = switch, policy, smoothing
        self._mean = np.full(policy.num_robots, np.nan)
        """Smoothed preference; NaN before the first one."""

    @property
    def probability(self) -> np.ndarray:
        """[N] logistic function of the smoothed preference."""
        return special.expit(np.nan_to_num(self._mean))

    def look(self, seen: SelectorInput) -> ImageGate:
        """Every image is VP's."""
        return ImageGate.open(seen.fresh)

    @torch.no_grad()
    def update(self, seen: SelectorInput, now: float) -> np.ndarray:
        """One update from the policy's newest step; returns [N] bool, vision is trusted."""
        del seen, now
        newest = self._switch.preference(self._policy.inputs).numpy()
        # Robots start with vision: a first preference below 0 is averaged with 0.
        before = np.where(np.isnan(self._mean), np.maximum(newest, 0.0), self._mean)
        self._mean = before + self._smoothing * (newest - before)
        return self._mean >= 0.0

    def distrust(self, mask: np.ndarray, reason: str) -> None:
        """The policy itself lets OP drive robots whose VP found no numbers."""

    def reset(self, mask: np.ndarray | None = None) -> None:
        """Start anew for the masked robots [N], by default for all."""
        self._mean[slice(None) if mask is None else mask] = np.nan


class SwitchEvaluator(Evaluator):
    """The bundle's policy, whose mode `memory` obeys a learned switch: any study can run it."""

    switch: ReturnSwitch | Gate | None = None
    """Set once it is trained; until then the bundle's own selector acts."""

    def make_policy(self, num_robots: int) -> ObservedPolicy:
        """The policy for N robots; the newest one is what the switch reads."""
        self._policy = ObservedPolicy(self.bundle, num_robots)
        return self._policy

    def make_selector(self, kind: str, num_robots: int) -> Selector:
        """What `memory` obeys: the switch for the newest policy, once it is trained."""
        if kind != "memory" or self.switch is None:
            return super().make_selector(kind, num_robots)
        return SwitchSelector(self.switch, self._policy)

    def provenance(self, seed: int) -> Provenance:
        """The bundle's, with the switch's class and weights: other results than the bundle's."""
        provenance = super().provenance(seed)
        if self.switch is None:
            return provenance
        weights = nn.utils.parameters_to_vector(self.switch.parameters()).detach().numpy()
        digest = hashlib.sha256(provenance.bundle_hash.encode() + weights.tobytes()).hexdigest()
        name = f"{provenance.bundle} with {type(self.switch).__name__}"
        return replace(provenance, bundle=name, bundle_hash=digest)


def collect(
    evaluator: SwitchEvaluator,
    env: EvalEnv,
    trials: Sequence[Trial],
    steps: int,
    seed: int,
    speed: float = 0.6,
) -> Experience:
    """Run trials and keep what a switch learns from.

    Args:
        evaluator: of the bundle.
        env: as many robots as trials.
        trials: in modes `camera` and `blind`, with and without faults.
        steps: control steps. seed: of the faults.
        speed: commanded, m/s; the reward of a step is the part of it that is reached, up to 1, and
            1 less where the step ends in a fall.
    """
    inputs: list[Tensor] = []
    rollout = evaluator.rollout(env, trials, seed)
    trace = rollout.run(
        steps, "experience", on_step=lambda step: inputs.append(evaluator._policy.inputs)
    )
    reward = np.clip(trace.forward_velocity / speed, 0.0, 1.0) - trace.fell
    arrays = (reward.astype(np.float32), trace.fell, trace.vision, trace.failing)
    return Experience(torch.stack(inputs), *map(torch.from_numpy, arrays))
