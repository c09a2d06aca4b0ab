"""Modality adaptation: which estimator steers, and what the actor then reads (RENet, eq. 3)."""

import torch
from torch import Tensor


def op_mask(perception: str, iteration: int, difficult: Tensor, period: int) -> Tensor:
    """The paper's mask_i, [N] bool: true where the OP estimator steers.

    On simple terrain all environments alternate every `period` iterations, VP first; where
    `difficult`, [N] or [N, 1], is not zero they always have vision.
    """
    simple = difficult.reshape(-1) == 0
    if perception == "op":
        return torch.ones_like(simple)
    return simple & (perception == "renet" and (iteration // period) % 2 == 1)


def fuse(latent_op: Tensor, latent_vp: Tensor, op_mask: Tensor) -> Tensor:
    """h = concat(h_b * mask, h_v * (1 - mask)), [B, 128], of latents [B, 64] (RENet, eq. 3).

    `op_mask`, [B] or [B, 1], is 1 where OP is selected and 0 for VP.
    """
    mask = op_mask.reshape(-1, 1).to(latent_op.dtype)
    return torch.cat((latent_op * mask, latent_vp * (1.0 - mask)), dim=-1)
