"""Anomaly detector: an autoencoder of two consecutive depth images (RENet, eq. 4)."""

import math
from itertools import pairwise

import torch
from torch import Tensor, nn

from renet.interface import DEPTH_SHAPE, FRAMES
from renet.models.config import Detector

CHANNELS = (8, 16, 32)
"""Channels of the three convolutions of the encoder."""
BOTTLENECK = 32
"""Width of the bottleneck of the paper's detector."""
SPATIAL_BOTTLENECK = 4
"""Channels of the bottleneck of the variance detector, at an eighth of the image's resolution."""
PIXEL_LOG_VARIANCE = (-10.0, 2.0)
"""Smallest and largest predicted log variance of a pixel; images are in [0, 1]."""


class DepthAutoencoder(nn.Module):
    """Convolutional autoencoder of image pairs (d_t, d_{t-1}), [B, 2, 48, 64] in [0, 1].

    The variance detector also predicts the variance of its error at each pixel. It learns that
    edges are hard to reconstruct and flat ground is easy, so that an error counts by how unusual
    it is.
    """

    def __init__(self, detector: Detector = "reconstruction") -> None:
        super().__init__()
        self.detector = detector
        third = CHANNELS[-1]
        # The three convolutions halve rows and columns each.
        rows, columns = DEPTH_SHAPE
        shape = (third, rows // 8, columns // 8)
        size = math.prod(shape)
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
        down = []
        up = []
        for wide, deep in pairwise((FRAMES, *CHANNELS)):
            down += [nn.Conv2d(wide, deep, 4, stride=2, padding=1), nn.ELU(inplace=True)]
        for deep, wide in pairwise((*reversed(CHANNELS), outputs)):
            up += [nn.ConvTranspose2d(deep, wide, 4, stride=2, padding=1), nn.ELU(inplace=True)]
        self.encode = nn.Sequential(*down, *narrow)
        self.decode = nn.Sequential(*widen, *up[:-1])
        # A seventh faster on a CPU.
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def predict(self, depth: Tensor) -> tuple[Tensor, Tensor | None]:
        """Reconstruct image pairs.

        Args:
            depth: Image pairs, [B, 2, 48, 64] in [0, 1].

        Returns:
            The reconstruction, [B, 2, 48, 64], and the log variance of each pixel's error, of the
            same shape, or None for the paper's detector.
        """
        # Images around zero rather than around a half.
        output = self.decode(self.encode(depth - 0.5))
        if self.detector != "variance":
            return output + 0.5, None
        reconstruction = output[:, :FRAMES] + 0.5
        log_variance = output[:, FRAMES:].clamp(*PIXEL_LOG_VARIANCE)
        return reconstruction, log_variance

    def loss(self, depth: Tensor) -> dict[str, Tensor]:
        """Compute the detector's losses on image pairs [B, 2, 48, 64]; scalars by name.

        `anomaly` is Loss_ad (eq. 4). The variance detector learns `anomaly_nll` in its place, the
        Gaussian negative log-likelihood of each pixel; its `anomaly` has no gradient.
        """
        reconstruction, log_variance = self.predict(depth)
        anomaly = anomaly_score(depth, reconstruction).mean()
        if log_variance is None:
            return {"anomaly": anomaly}
        ratio = (depth - reconstruction) ** 2 / log_variance.exp()
        nll = 0.5 * (ratio + log_variance).mean()
        return {"anomaly": anomaly.detach(), "anomaly_nll": nll}


def anomaly_score(depth: Tensor, reconstruction: Tensor) -> Tensor:
    """Compute Loss_ad of each pair, [B]: the mean squared error over both images (RENet, eq. 4)."""
    return torch.mean((depth - reconstruction) ** 2, dim=(1, 2, 3))


def variance_score(depth: Tensor, reconstruction: Tensor, log_variance: Tensor) -> Tensor:
    """Compute the mean ratio of a pair's squared errors to their predicted variances, [B].

    It is about 1 for images like those of training.
    """
    return torch.mean((depth - reconstruction) ** 2 / log_variance.exp(), dim=(1, 2, 3))
