"""Hybrid internal model loss (HIMLoco, ICLR 2024), as RENet uses it on both estimators.

The estimator's latent is the source view of what happens next; the robot's next state is the
target view. Both are assigned to shared prototypes, and each view must predict the other's
assignment (swapped prediction), so that the latent carries the robot's response.
"""

import torch
import torch.nn.functional as functional
from torch import Tensor, nn

from renet.interface import LATENT, PROPRIOCEPTION_SIZE, proprioception_slices
from renet.models.actor_critic import mlp

SINKHORN_EPSILON = 0.05
SINKHORN_ITERATIONS = 3
TEMPERATURE = 0.1
"""SwAV's (Caron et al. 2020). At HIMLoco's 3.0 the loss hardly prefers 32 separated prototypes
(3.13) to two antipodal heaps of them (3.19), and the prototypes collapse; docs/choices.md."""
PROTOTYPES = 32
VIEW = 16


class HybridInternalModel(nn.Module):
    """Source head, target encoder and prototypes of one estimator."""

    def __init__(self) -> None:
        super().__init__()
        self.source = nn.Linear(LATENT, VIEW)
        self.target = mlp((PROPRIOCEPTION_SIZE, 128, 64, VIEW))
        self.prototypes = nn.Linear(VIEW, PROTOTYPES, bias=False)
        self.usage: Tensor | None = None
        """Number of prototypes the last batch's sources used, a scalar in [1, 32]: the exponential
        of the entropy of their mean assignment."""

    def forward(self, latent: Tensor, next_state: Tensor, counts: Tensor) -> Tensor:
        """Loss_HIM of latents and the states that followed them.

        Args:
            latent: h_b or h_v, [B, 64]. next_state: `target_view` of the next step, [B, 45].
            counts: 1 for pairs that count, 0 for pairs to leave out, [B].

        Returns:
            Scalar; ln(32) / 32 = 0.108 when assignments are predicted no better than chance.
        """
        source = functional.normalize(self.source(latent), dim=-1)
        prototypes = functional.normalize(self.prototypes.weight, dim=-1)
        with torch.no_grad():
            assigned = torch.softmax(source @ prototypes.T / TEMPERATURE, dim=-1)
            mean = (assigned * counts.unsqueeze(-1)).sum(0) / counts.sum().clamp_min(1.0)
            self.usage = torch.exp(torch.special.entr(mean).sum())
        target = functional.normalize(self.target(next_state), dim=-1)
        return swapped_prediction_loss(source, target, prototypes, counts)

    @torch.no_grad()
    def effective_rank(self) -> Tensor:
        """Effective rank of the prototypes (Roy and Vetterli 2007), a scalar in [1, 16].

        The exponential of the entropy of the normalised singular values; 1 means that all
        prototypes lie on one line: the module has collapsed and teaches nothing.
        """
        prototypes = functional.normalize(self.prototypes.weight, dim=-1)
        finite = prototypes.isfinite().all()
        # Of what is not finite a decomposition raises; training stops and says so.
        singular = torch.linalg.svdvals(prototypes.nan_to_num(0.0, 0.0, 0.0))
        rank = torch.exp(torch.special.entr(singular / singular.sum()).sum())
        return torch.where(finite, rank, torch.nan)


def target_view(proprioception: Tensor, velocity: Tensor) -> Tensor:
    """The target encoder's input (HIMLoco): the state without the command, with the velocity.

    Args:
        proprioception: noise-free o_{t+1}, [..., 45].
        velocity: base linear velocity at t+1 in the base frame, [..., 3] m/s.

    Returns:
        o_{t+1} whose three command numbers are replaced by the velocity, [..., 45].
    """
    command = proprioception_slices()["command"]
    before, after = proprioception[..., : command.start], proprioception[..., command.stop :]
    return torch.cat((before, after, velocity), dim=-1)


def swapped_prediction_loss(
    source: Tensor, target: Tensor, prototypes: Tensor, counts: Tensor
) -> Tensor:
    """Half the sum of both cross-entropies, averaged over pairs and prototypes.

    Args:
        source, target: unit vectors, [B, 16]. prototypes: unit vectors, [32, 16].
        counts: 1 or 0, [B].

    Returns:
        Scalar; the mean runs over all B * 32 entries, as in HIMLoco's code.
    """
    source_score, target_score = source @ prototypes.T, target @ prototypes.T
    with torch.no_grad():
        source_assignment = sinkhorn(source_score, counts)
        target_assignment = sinkhorn(target_score, counts)
    source_log = functional.log_softmax(source_score / TEMPERATURE, dim=-1)
    target_log = functional.log_softmax(target_score / TEMPERATURE, dim=-1)
    crossed = (source_assignment * target_log).mean(-1) + (target_assignment * source_log).mean(-1)
    return -0.5 * (crossed * counts).sum() / counts.sum().clamp_min(1.0)


def sinkhorn(score: Tensor, counts: Tensor) -> Tensor:
    """Soft assignment [B, K] whose columns are used equally and whose rows sum to `counts`."""
    # Subtracting the maximum changes nothing after normalisation and keeps exp finite.
    assignment = torch.exp((score - score.max()) / SINKHORN_EPSILON)
    assignment = assignment * counts.unsqueeze(-1)
    batch, prototypes = counts.sum().clamp_min(1.0), score.shape[1]
    for _ in range(SINKHORN_ITERATIONS):
        assignment = assignment / assignment.sum(0, keepdim=True).clamp_min(1e-30) / prototypes
        assignment = assignment / assignment.sum(1, keepdim=True).clamp_min(1e-30) / batch
    return assignment * batch
