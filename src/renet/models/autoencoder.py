"""The anomaly detector: an autoencoder of two consecutive depth images (RENet, eq. 4)."""

from itertools import pairwise

import torch
from torch import Tensor, nn

from renet.interface import DEPTH_SHAPE, FRAMES
from renet.models.config import Detector

CHANNELS = (8, 16, 32)
"""Channels of the three convolutions of the encoder."""
BOTTLENECK = 32
"""Width of the paper's detector between encoder and decoder."""
SPATIAL_BOTTLENECK = 4
"""Channels of the variance detector there, at an eighth of the image's resolution."""
LOG_VARIANCE = (-10.0, 2.0)
"""Range of the predicted log variance of a pixel; images are in [0, 1]."""


class DepthAutoencoder(nn.Module):
    """Convolutions down, deconvolutions up, over (d_t, d_{t-1}): [B, 2, 48, 64] to the same.

    The variance detector also predicts the variance of its own error at each pixel. It knows that
    edges are hard to draw and flat ground is not, so that an error counts by how unusual it is.
    """

    def __init__(self, detector: Detector = "reconstruction") -> None:
        super().__init__()
        self.detector = detector
        third = CHANNELS[-1]
        shape = (third, *(size // 8 for size in DEPTH_SHAPE))
        size = shape[0] * shape[1] * shape[2]
        narrow: list[nn.Module]
        widen: list[nn.Module]
        if detector == "variance":
            outputs = 2 * FRAMES
            narrow = [nn.Conv2d(third, SPATIAL_BOTTLENECK, 1)]
            widen = [nn.Conv2d(SPATIAL_BOTTLENECK, third, 1), nn.ELU(inplace=True)]
        else:
            outputs = FRAMES
            narrow = [nn.Flatten(), nn.Linear(size, BOTTLENECK)]
            widen = [nn.Linear(BOTTLENECK, size), nn.ELU(inplace=True), nn.Unflatten(1, shape)]
        down, up = [], []
        for wide, deep in pairwise((FRAMES, *CHANNELS)):
            down += [nn.Conv2d(wide, deep, 4, stride=2, padding=1), nn.ELU(inplace=True)]
        for deep, wide in pairwise((*reversed(CHANNELS), outputs)):
            up += [nn.ConvTranspose2d(deep, wide, 4, stride=2, padding=1), nn.ELU(inplace=True)]
        self.encode = nn.Sequential(*down, *narrow)
        self.decode = nn.Sequential(*widen, *up[:-1])
        # A seventh faster on a CPU.
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def predict(self, depth: Tensor) -> tuple[Tensor, Tensor | None]:
        """Reconstruct depth images.

        Args:
            depth: [B, 2, 48, 64] in [0, 1].

        Returns:
            The reconstruction, [B, 2, 48, 64], and of the variance detector the logarithm of the
            variance of each pixel's error, else None.
        """
        decoded = self.decode(self.encode(depth - 0.5))
        if self.detector != "variance":
            return decoded + 0.5, None
        return decoded[:, :FRAMES] + 0.5, decoded[:, FRAMES:].clamp(*LOG_VARIANCE)

    def loss(self, depth: Tensor) -> dict[str, Tensor]:
        """What the detector learns from image pairs [B, 2, 48, 64]; named scalars.

        `anomaly` is Loss_ad (eq. 4). Of the variance detector it is logged, not learned:
        `anomaly_nll`, the Gaussian negative log-likelihood of each pixel, takes its place.
        """
        reconstruction, log_variance = self.predict(depth)
        anomaly = anomaly_score(depth, reconstruction).mean()
        if log_variance is None:
            return {"anomaly": anomaly}
        scaled = (depth - reconstruction) ** 2 / log_variance.exp()
        return {"anomaly": anomaly.detach(), "anomaly_nll": 0.5 * (scaled + log_variance).mean()}


def anomaly_score(depth: Tensor, reconstruction: Tensor) -> Tensor:
    """Loss_ad of each pair, [B]: mean squared error over both images (RENet, eq. 4)."""
    return torch.mean((depth - reconstruction) ** 2, dim=(1, 2, 3))


def variance_score(depth: Tensor, reconstruction: Tensor, log_variance: Tensor) -> Tensor:
    """Mean over both images of each pixel's squared error over its predicted variance, [B].

    About 1 for images like training's, whatever they show.
    """
    return torch.mean((depth - reconstruction) ** 2 / log_variance.exp(), dim=(1, 2, 3))
