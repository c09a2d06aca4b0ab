"""Depth errors added in training (RENet, Method C, "Raycaster Randomization")."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass
class DepthNoiseCfg:
    """The paper states 1 % distance noise and Gaussian noise of variance 0.01, without a unit."""

    relative_std: float = 0.01
    """Standard deviation of the error proportional to distance (Gaussian), m/m."""
    gaussian_std: float = 0.1
    """Standard deviation of the constant error, m: variance 0.01 read literally as m^2."""


def add_noise(depth: Tensor, cfg: DepthNoiseCfg) -> Tensor:
    """Noisy depth of the same shape, m; draws from torch's global generator.

    Both errors are independent Gaussians, hence one draw with the summed variance.
    """
    if cfg.relative_std == 0.0 and cfg.gaussian_std == 0.0:
        return depth
    variance = (cfg.relative_std * depth) ** 2 + cfg.gaussian_std**2
    return depth + variance.sqrt() * torch.randn_like(depth)
