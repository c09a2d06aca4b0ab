"""Online estimator adaptation: which estimator steers each environment (RENet, Method A)."""

from __future__ import annotations

import torch
from torch import Tensor


def op_mask(perception: str, iteration: int, difficult: Tensor, period: int) -> Tensor:
    """The paper's mask_i: true where the OP estimator steers.

    On simple terrain all environments alternate every `period` iterations, VP first; difficult
    terrain always has vision.

    Args:
        perception: of the ModelCfg. iteration: learning iteration.
        difficult: [N] or [N, 1], nonzero where the terrain forces vision.

    Returns:
        [N] bool.
    """
    simple = difficult.reshape(-1) == 0
    if perception == "op":
        return torch.ones_like(simple)
    if perception == "renet" and (iteration // period) % 2 == 1:
        return simple
    return torch.zeros_like(simple)
