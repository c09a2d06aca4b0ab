"""Online estimator adaptation: which estimator steers each environment (RENet, Method A)."""

from __future__ import annotations

import torch
from torch import Tensor

from renet.models.config import ModelCfg


def op_mask(
    perception: ModelCfg | str, iteration: int, difficult: Tensor, period: int = 20
) -> Tensor:
    """The paper's mask_i: true where the OP estimator steers.

    On simple terrain all environments alternate every `period` iterations, VP first; difficult
    terrain always has vision.

    Args:
        perception: a ModelCfg or its `perception` field. iteration: learning iteration.
        difficult: [N] or [N, 1], nonzero where the terrain forces vision.

    Returns:
        [N] bool.
    """
    mode = perception if isinstance(perception, str) else perception.perception
    simple = difficult.reshape(-1) == 0
    if mode == "op":
        return torch.ones_like(simple)
    if mode == "renet" and (iteration // period) % 2 == 1:
        return simple
    return torch.zeros_like(simple)
