"""Hybrid internal model loss (HIMLoco, ICLR 2024), as RENet uses it on both estimators.

The estimator's latent is the source view of the next state, the next state itself the target view.
Both are assigned to shared prototypes, and each view must predict the other's assignment (swapped
prediction), so that the latent holds the robot's response.
"""

import torch
import torch.nn.functional as functional
from torch import Tensor, nn

from renet.interface import LATENT, PROPRIOCEPTION_SIZE, proprioception_slices
from renet.models.actor_critic import mlp

SINKHORN_EPSILON = 0.05
"""Entropy regularisation of assignments."""
SINKHORN_ITERATIONS = 3
TEMPERATURE = 0.1
"""Temperature of predicted assignments, SwAV's (Caron et al. 2020). At HIMLoco's 3.0 the loss of 32
separated prototypes (3.13) is hardly below that of two antipodal heaps of them (3.19), and the
prototypes collapse; see benchmarks/NOTES.md."""
PROTOTYPES = 32
"""Number of prototypes."""
VIEW = 16
"""Width of views and prototypes."""


class HybridInternalModel(nn.Module):
    """Source head, target encoder and prototypes of one estimator."""

    def __init__(self) -> None:
        super().__init__()
        self.source = nn.Linear(LATENT, VIEW)
        self.target = mlp((PROPRIOCEPTION_SIZE, 128, 64, VIEW))
        self.prototypes = nn.Linear(VIEW, PROTOTYPES, bias=False)
        self.usage: Tensor | None = None
        """Number of prototypes that the sources of the last batch use, a scalar in [1, 32]: the
        exponential of the entropy of their mean assignment."""

    def forward(self, latent: Tensor, next_state: Tensor, counts: Tensor) -> Tensor:
        """Compute Loss_HIM of latents and the states one control step later.

        Args:
            latent: Latents h_b or h_v, [B, 64].
            next_state: States one control step later (see `target_view`), [B, 45].
            counts: 1 for pairs that count, 0 for pairs to leave out, [B].

        Returns:
            Scalar; ln(32) / 32 = 0.108 if assignments are predicted no better than by chance.
        """
        source = functional.normalize(self.source(latent), dim=-1)
        prototypes = functional.normalize(self.prototypes.weight, dim=-1)
        with torch.no_grad():
            assignment = torch.softmax(source @ prototypes.T / TEMPERATURE, dim=-1)
            mean = (assignment * counts.unsqueeze(-1)).sum(0) / counts.sum().clamp_min(1.0)
            self.usage = torch.exp(torch.special.entr(mean).sum())
        target = functional.normalize(self.target(next_state), dim=-1)
        return swapped_prediction_loss(source, target, prototypes, counts)

    @torch.no_grad()
    def effective_rank(self) -> Tensor:
        """Compute the effective rank of the prototypes (Roy and Vetterli 2007).

        It is the exponential of the entropy of the normalised singular values. At 1 all prototypes
        lie on one line: the module has collapsed and trains nothing.

        Returns:
            Scalar in [1, 16], or NaN if a prototype is not finite.
        """
        prototypes = functional.normalize(self.prototypes.weight, dim=-1)
        finite = prototypes.isfinite().all()
        # The decomposition raises for NaN; the runner reports it with the losses.
        singular_values = torch.linalg.svdvals(prototypes.nan_to_num(0.0, 0.0, 0.0))
        shares = singular_values / singular_values.sum()
        rank = torch.exp(torch.special.entr(shares).sum())
        return torch.where(finite, rank, torch.nan)


def target_view(proprioception: Tensor, velocity: Tensor) -> Tensor:
    """Build the target encoder's input (HIMLoco): the state without command, with the velocity.

    Args:
        proprioception: Noise-free o_{t+1}, [..., 45].
        velocity: Base linear velocity at t+1 in the base frame, [..., 3] m/s.

    Returns:
        o_{t+1} without its three numbers of the command, followed by the velocity, [..., 45].
    """
    command = proprioception_slices()["command"]
    parts = (
        proprioception[..., : command.start],
        proprioception[..., command.stop :],
        velocity,
    )
    return torch.cat(parts, dim=-1)


def swapped_prediction_loss(
    source: Tensor, target: Tensor, prototypes: Tensor, counts: Tensor
) -> Tensor:
    """Compute half the sum of both cross-entropies, averaged over pairs and prototypes.

    Args:
        source: Source views, unit vectors, [B, 16].
        target: Target views, unit vectors, [B, 16].
        prototypes: Prototypes, unit vectors, [32, 16].
        counts: 1 for pairs that count, 0 for others, [B].

    Returns:
        Scalar; the mean is over all B * 32 entries, as in HIMLoco's code.
    """
    source_score = source @ prototypes.T
    target_score = target @ prototypes.T
    with torch.no_grad():
        source_assignment = sinkhorn(source_score, counts)
        target_assignment = sinkhorn(target_score, counts)
    source_log = functional.log_softmax(source_score / TEMPERATURE, dim=-1)
    target_log = functional.log_softmax(target_score / TEMPERATURE, dim=-1)
    # Each view predicts the other's assignment.
    agreement = (source_assignment * target_log).mean(-1)
    agreement = agreement + (target_assignment * source_log).mean(-1)
    return -0.5 * (agreement * counts).sum() / counts.sum().clamp_min(1.0)


def sinkhorn(score: Tensor, counts: Tensor) -> Tensor:
    """Compute soft assignments that use all prototypes equally.

    Args:
        score: Similarities of views and prototypes, [B, K].
        counts: Sums of the assignments' rows, [B]: 1, or 0 for pairs to leave out.

    Returns:
        Assignments, [B, K].
    """
    # Subtracting the maximum changes nothing after normalisation, and keeps exp finite.
    assignment = torch.exp((score - score.max()) / SINKHORN_EPSILON)
    assignment = assignment * counts.unsqueeze(-1)
    batch = counts.sum().clamp_min(1.0)
    prototypes = score.shape[1]
    for _ in range(SINKHORN_ITERATIONS):
        # Columns sum to 1 / K, then rows to counts / B.
        assignment = assignment / assignment.sum(0, keepdim=True).clamp_min(1e-30) / prototypes
        assignment = assignment / assignment.sum(1, keepdim=True).clamp_min(1e-30) / batch
    return assignment * batch
