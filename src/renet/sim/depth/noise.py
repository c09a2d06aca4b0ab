"""Depth errors added in training (RENet, Method C, "Raycaster Randomization")."""

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass
class DepthNoiseCfg:
    """Gaussian errors of every pixel: one in proportion to distance, one constant."""

    relative_std: float = 0.01
    """Standard deviation of the error in proportion to distance, m/m (paper: 1 %)."""
    gaussian_std: float = 0.1
    """Standard deviation of the constant error, m. The paper says "variance 0.01" without a unit:
    0.1 reads it as m²; 0.01 would read it as a standard deviation in m, and 0.2 as the variance of
    depth divided by its 2 m range."""


def add_noise(depth: Tensor, cfg: DepthNoiseCfg) -> Tensor:
    """Noisy depth of the same shape, m; draws from torch's global generator.

    Both errors are independent Gaussians, hence one draw with the summed variance.
    """
    if cfg.relative_std == 0.0 and cfg.gaussian_std == 0.0:
        return depth
    variance = (cfg.relative_std * depth) ** 2 + cfg.gaussian_std**2
    return depth + variance.sqrt() * torch.randn_like(depth)
