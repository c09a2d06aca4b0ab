"""First compression of an estimator's inputs (paper: two-layer MLP, light three-layer CNN)."""

import torch
from torch import Tensor, nn

from renet.interface import DEPTH_SHAPE, PROPRIOCEPTION_SIZE


class ProprioceptionEmbedding(nn.Sequential):
    """Two-layer MLP for o_t^{H1}: [B, H1, 45] to [B, width]."""

    def __init__(self, history: int, width: int) -> None:
        super().__init__(
            nn.Flatten(),
            nn.Linear(history * PROPRIOCEPTION_SIZE, 2 * width),
            nn.ELU(inplace=True),
            nn.Linear(2 * width, width),
            nn.ELU(inplace=True),
        )


class DepthEmbedding(nn.Module):
    """Three-layer CNN for d_t^{H2}: [B, H2, 48, 64] in [0, 1] to [B, width]."""

    def __init__(self, frames: int, width: int) -> None:
        super().__init__()
        self.convolutions = nn.Sequential(
            nn.Conv2d(frames, 16, 5, stride=2, padding=2),
            nn.ELU(inplace=True),
            nn.Conv2d(16, 32, 3, stride=2, padding=1),
            nn.ELU(inplace=True),
            nn.Conv2d(32, 32, 3, stride=2, padding=1),
            nn.ELU(inplace=True),
        )
        # A third faster on a CPU.
        self.convolutions.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        rows, columns = (size // 8 for size in DEPTH_SHAPE)
        self.project = nn.Sequential(nn.Linear(32 * rows * columns, width), nn.ELU(inplace=True))

    def forward(self, depth: Tensor) -> Tensor:
        """Embed depth images; centring them keeps the first layer's inputs zero-mean."""
        return self.project(torch.flatten(self.convolutions(depth - 0.5), 1))
