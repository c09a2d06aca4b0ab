"""The anomaly detector: an autoencoder of two consecutive depth images (RENet, eq. 4)."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from renet.interface import DEPTH_SHAPE, FRAMES

BOTTLENECK = 32


class DepthAutoencoder(nn.Module):
    """Convolutions down, deconvolutions up, over (d_t, d_{t-1}): [B, 2, 48, 64] to the same."""

    def __init__(self, channels: tuple[int, int, int] = (8, 16, 32)) -> None:
        super().__init__()
        first, second, third = channels
        rows, columns = (size // 8 for size in DEPTH_SHAPE)
        self.encode = nn.Sequential(
            nn.Conv2d(FRAMES, first, 4, stride=2, padding=1),
            nn.ELU(inplace=True),
            nn.Conv2d(first, second, 4, stride=2, padding=1),
            nn.ELU(inplace=True),
            nn.Conv2d(second, third, 4, stride=2, padding=1),
            nn.ELU(inplace=True),
            nn.Flatten(),
            nn.Linear(third * rows * columns, BOTTLENECK),
        )
        self.decode = nn.Sequential(
            nn.Linear(BOTTLENECK, third * rows * columns),
            nn.ELU(inplace=True),
            nn.Unflatten(1, (third, rows, columns)),
            nn.ConvTranspose2d(third, second, 4, stride=2, padding=1),
            nn.ELU(inplace=True),
            nn.ConvTranspose2d(second, first, 4, stride=2, padding=1),
            nn.ELU(inplace=True),
            nn.ConvTranspose2d(first, FRAMES, 4, stride=2, padding=1),
        )
        # A seventh faster on a CPU.
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def forward(self, depth: Tensor) -> Tensor:
        """Reconstruct depth images in [0, 1]."""
        return self.decode(self.encode(depth - 0.5)) + 0.5


def anomaly_score(depth: Tensor, reconstruction: Tensor) -> Tensor:
    """Loss_ad of each pair, [B]: mean squared error over both images (RENet, eq. 4)."""
    return torch.mean((depth - reconstruction) ** 2, dim=(1, 2, 3))
