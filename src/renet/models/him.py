"""Hybrid internal model loss (HIMLoco, ICLR 2024), as RENet uses it on both estimators.

The estimator's latent is the source view of what happens next; the next proprioception is the
target view. Both are assigned to shared prototypes, and each view must predict the other's
assignment (swapped prediction), so that the latent carries the robot's response.
"""

from __future__ import annotations

import torch
import torch.nn.functional as functional
from torch import Tensor, nn

from renet.interface import LATENT, PROPRIOCEPTION_SIZE

SINKHORN_EPSILON = 0.05
SINKHORN_ITERATIONS = 3
TEMPERATURE = 3.0
PROTOTYPES = 32
VIEW = 16


class HybridInternalModel(nn.Module):
    """Source head, target encoder and prototypes of one estimator."""

    def __init__(self) -> None:
        super().__init__()
        self.source = nn.Linear(LATENT, VIEW)
        self.target = nn.Sequential(
            nn.Linear(PROPRIOCEPTION_SIZE, 128),
            nn.ELU(inplace=True),
            nn.Linear(128, 64),
            nn.ELU(inplace=True),
            nn.Linear(64, VIEW),
        )
        self.prototypes = nn.Linear(VIEW, PROTOTYPES, bias=False)

    def forward(
        self, latent: Tensor, next_proprioception: Tensor, counts: Tensor | None = None
    ) -> Tensor:
        """Loss_HIM, a scalar, of latents [B, 64] and the proprioceptions [B, 45] that followed.

        Pairs whose `counts` [B] is 0 are as if they were absent; those that count have 1.
        """
        return swapped_prediction_loss(
            functional.normalize(self.source(latent), dim=-1),
            functional.normalize(self.target(next_proprioception), dim=-1),
            functional.normalize(self.prototypes.weight, dim=-1),
            torch.ones_like(latent[:, 0]) if counts is None else counts,
        )


def swapped_prediction_loss(
    source: Tensor, target: Tensor, prototypes: Tensor, counts: Tensor
) -> Tensor:
    """Half the sum of both cross-entropies, each view against the other's assignment.

    Args:
        source, target: unit vectors [B, 16]. prototypes: unit vectors [32, 16].
        counts: [B], 1 or 0.
    """
    source_score, target_score = source @ prototypes.T, target @ prototypes.T
    with torch.no_grad():
        source_assignment = sinkhorn(source_score, counts)
        target_assignment = sinkhorn(target_score, counts)
    source_log = functional.log_softmax(source_score / TEMPERATURE, dim=-1)
    target_log = functional.log_softmax(target_score / TEMPERATURE, dim=-1)
    crossed = (source_assignment * target_log).sum(-1) + (target_assignment * source_log).sum(-1)
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
