"""Storage of one rollout: the policy's steps at 50 Hz and the estimators' ticks at 10 Hz."""

from dataclasses import dataclass, fields
from typing import Self

import torch
from torch import Tensor


@dataclass
class PolicyRollout:
    """T control steps of N environments, tensors [T, N, ...]."""

    proprioception: Tensor
    """Noisy proprioception o_t, [T, N, 45]."""
    latent: Tensor
    """Latent h that the actor read, detached, [T, N, 128]."""
    mirrored_latent: Tensor
    """Latent that the actor would read in the mirror, [T, N, 128], or [T, N, 0] without mirror
    loss."""
    critic_observation: Tensor
    """Observations of the critics, [T, N, C]."""
    action: Tensor
    """Actions, [T, N, 12]."""
    log_prob: Tensor
    """Log-probabilities of the actions at collection, [T, N]."""
    mean: Tensor
    """Means of the action distribution at collection, [T, N, 12]."""
    value: Tensor
    """Values of the reward and of each cost, [T, N, 1 + constraints]."""
    rewards_and_costs: Tensor
    """Reward and costs, bootstrapped at time-outs, [T, N, 1 + constraints]."""
    done: Tensor
    """True where the step ended its episode, [T, N] bool."""

    def flatten(self) -> Self:
        """Merge time and environments: [T * N, ...]."""
        tensors = {f.name: getattr(self, f.name).flatten(0, 1) for f in fields(self)}
        return type(self)(**tensors)


@dataclass
class TickRollout:
    """K estimator ticks of N environments, tensors [K, N, ...]."""

    history: Tensor
    """Proprioceptions o^{H1} of the last H1 control steps, [K, N, H1, 45]."""
    frames: Tensor
    """Depth images (d_t, d_{t-1}) in [0, 1], float16, [K, N, 2, 48, 64]."""
    has_image: Tensor
    """False where the image of this tick was withheld, [K, N] bool."""
    fresh: Tensor
    """True where an episode began since the previous tick, [K, N] bool."""
    op_mask: Tensor
    """True where OP steers, [K, N] bool."""
    velocity: Tensor
    """Base velocity, base frame, [K, N, 3] m/s."""
    feet_height: Tensor
    """Heights of the feet above the ground, [K, N, 4] m."""
    height_map: Tensor
    """Height map, [K, N, 132] m."""
    far_map: Tensor
    """Heights beyond the height map, [K, N, 30] m."""
    next_proprioception: Tensor
    """Noise-free proprioception one control step later, [K, N, 45]."""
    next_velocity: Tensor
    """Base velocity one control step later, base frame, [K, N, 3] m/s."""
    next_valid: Tensor
    """False where that control step ended the episode, [K, N] bool."""
    blocks: Tensor
    """Blocks of the image of this tick, also of one that was withheld, float16, [K, N, 192], or
    [K, N, 0] for a model without an expectation (see `renet.models.expectation`)."""
    last_blocks: Tensor
    """Blocks of the last image that VP was given before, likewise."""
    image_age: Tensor
    """Time for which images had been withheld before the tick, [K, N] s."""
    latent_op: Tensor
    """OP's latent h_b before the tick, [K, N, 64]."""
    latent_vp: Tensor
    """VP's latent h_v before the tick, [K, N, 64]."""

    def environments(self, index: Tensor) -> Self:
        """Select the whole sequences of the environments in `index`, [B]."""
        tensors = {f.name: getattr(self, f.name)[:, index] for f in fields(self)}
        return type(self)(**tensors)


class StepBuffer:
    """Steps or ticks as dictionaries, stacked once at the end of a rollout.

    Values are copied, because environments reuse their buffers (mjlab that of time-outs).
    """

    def __init__(self) -> None:
        self._rows: list[dict[str, Tensor]] = []

    def begin(self, **values: Tensor) -> None:
        """Add a row, with the values that are known before the environment steps."""
        self._rows.append({})
        self.finish(**values)

    @property
    def newest(self) -> dict[str, Tensor]:
        """The row added last."""
        return self._rows[-1]

    def finish(self, **values: Tensor) -> None:
        """Add the results of the environment step to the newest row."""
        for name, value in values.items():
            self.newest[name] = value.clone()

    def stack(self) -> dict[str, Tensor]:
        """Return all rows as tensors [T, ...] by name, and empty the buffer."""
        rows = self._rows
        self._rows = []
        return {key: torch.stack([row[key] for row in rows]) for key in rows[0]}
