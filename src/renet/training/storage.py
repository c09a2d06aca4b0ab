"""One rollout: what the policy saw at 50 Hz and what the estimators saw at 10 Hz."""

from dataclasses import dataclass, fields
from typing import Self

import torch
from torch import Tensor


@dataclass
class PolicyRollout:
    """Tensors [T, N, ...] of T control steps, in the order they were taken."""

    proprioception: Tensor
    """o_t, noisy, [T, N, 45]."""
    latent: Tensor
    """h as the actor read it, detached, [T, N, 128]."""
    critic_observation: Tensor
    """[T, N, C]."""
    action: Tensor
    """[T, N, 12]."""
    log_prob: Tensor
    """[T, N]."""
    mean: Tensor
    """Action mean at collection, [T, N, 12]."""
    value: Tensor
    """Reward and cost values, [T, N, 1 + constraints]."""
    rewards_and_costs: Tensor
    """Reward and costs, bootstrapped at time-outs, [T, N, 1 + constraints]."""
    done: Tensor
    """Episode ended with this step, [T, N] bool."""

    def flatten(self) -> Self:
        """Merge time and environments: [T * N, ...]."""
        return type(self)(*(getattr(self, f.name).flatten(0, 1) for f in fields(self)))


@dataclass
class TickRollout:
    """Tensors [K, N, ...] of K estimator ticks."""

    history: Tensor
    """o^{H1}, [K, N, H1, 45]."""
    frames: Tensor
    """(d_t, d_{t-1}) in [0, 1], float16, [K, N, 2, 48, 64]."""
    has_image: Tensor
    """False where the image of this tick was withheld, [K, N] bool."""
    fresh: Tensor
    """Episode began since the previous tick, [K, N] bool."""
    op_mask: Tensor
    """OP steers, [K, N] bool."""
    velocity: Tensor
    """[K, N, 3]."""
    feet_height: Tensor
    """[K, N, 4]."""
    height_map: Tensor
    """[K, N, 132]."""
    far_map: Tensor
    """[K, N, 30]."""
    next_proprioception: Tensor
    """Noise-free proprioception one control step later, [K, N, 45]."""
    next_velocity: Tensor
    """Base velocity of that moment, base frame, [K, N, 3] m/s."""
    next_valid: Tensor
    """False where that step ended the episode, [K, N] bool."""
    latent_op: Tensor
    """h_b before the tick, [K, N, 64]."""
    latent_vp: Tensor
    """h_v before the tick, [K, N, 64]."""

    def environments(self, index: Tensor) -> Self:
        """Whole sequences of the environments in `index`."""
        return type(self)(*(getattr(self, f.name)[:, index] for f in fields(self)))


class Recorder:
    """Collects steps or ticks as dictionaries and stacks them once, at the end of a rollout.

    Values are copied: environments reuse their buffers, as mjlab does that of time-outs.
    """

    def __init__(self) -> None:
        self._rows: list[dict[str, Tensor]] = []

    def begin(self, **values: Tensor) -> None:
        """Start a row with what is known before the environment steps."""
        self._rows.append({})
        self.finish(**values)

    @property
    def newest(self) -> dict[str, Tensor]:
        """The row begun last."""
        return self._rows[-1]

    def finish(self, **values: Tensor) -> None:
        """Complete the newest row with what the step brought."""
        self.newest.update({name: value.clone() for name, value in values.items()})

    def stack(self) -> dict[str, Tensor]:
        """All rows as [T, ...] tensors; the recorder is then empty."""
        rows, self._rows = self._rows, []
        return {key: torch.stack([row[key] for row in rows]) for key in rows[0]}
