"""Modality adaptation: which estimator steers, and the actor's input (RENet, eq. 3)."""

import torch
from torch import Tensor


def op_mask(perception: str, iteration: int, difficult: Tensor, period: int) -> Tensor:
    """Compute the paper's mask_i, [N] bool, which is true where OP steers.

    On simple terrain the estimators take turns of `period` iterations, VP first. On difficult
    terrain VP always steers.

    Args:
        perception: Field of ModelCfg.
        iteration: Number of finished iterations.
        difficult: Not zero on difficult terrain, [N] or [N, 1].
        period: Iterations of a turn.
    """
    simple = difficult.reshape(-1) == 0
    if perception == "op":
        return torch.ones_like(simple)
    is_turn_of_op = perception == "renet" and (iteration // period) % 2 == 1
    return simple & is_turn_of_op


def fuse(latent_op: Tensor, latent_vp: Tensor, op_mask: Tensor) -> Tensor:
    """Compute the actor's latent h = concat(h_b * mask, h_v * (1 - mask)) (RENet, eq. 3).

    Args:
        latent_op: Latents h_b of OP, [B, 64].
        latent_vp: Latents h_v of VP, [B, 64].
        op_mask: 1 where OP is selected, 0 where VP is, [B] or [B, 1].

    Returns:
        Latents h, [B, 128].
    """
    mask = op_mask.reshape(-1, 1).to(latent_op.dtype)
    return torch.cat((latent_op * mask, latent_vp * (1.0 - mask)), dim=-1)
