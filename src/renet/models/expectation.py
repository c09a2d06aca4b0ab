"""Expectation of the next image from VP's memory, the robot's motion and the last image.

An autoencoder knows what images look like, but not what the next image should show. An image that
is turned, of a wrong scale or washed over by stray light may look like any other, and contradicts
what the robot has just seen. Images that stand still in part, or trail behind, contradict it a
little at each step, and are told by all steps of half a second together.
"""

from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from renet.interface import DEPTH_SHAPE, LATENT, PROPRIOCEPTION_SIZE

BLOCK_SIDE = 4
"""Side of the blocks of pixels whose mean depth is expected, pixels."""
BLOCKS = DEPTH_SHAPE[0] * DEPTH_SHAPE[1] // BLOCK_SIDE**2
"""Number of blocks of an image."""
STEPS_BACK = (0, 5, 8)
"""Ages of the proprioceptions that are read, control steps: now, at the tick before, and when an
image was taken that arrived late."""
MOTION = 128
"""Width of the embedded motion."""
HIDDEN = 160
"""Width of the hidden layers. Wider ones would make a bundle larger than 3 MB."""
FREEDOM = 4.0
"""Degrees of freedom of the errors' distribution."""
FIRST_BLOCK_LOG_VARIANCE = -5.0
"""Log variance of a block's error before training: 16 cm of 2 m."""
BLOCK_LOG_VARIANCE = (-8.0, -3.0)
"""Smallest and largest predicted log variance of a block's error; depths are in [0, 1]."""
LARGEST_ERROR = 3.0
"""Error of a block, in standard deviations, above which it counts as that large: an edge that comes
into view says little of how the rest of the image moves."""
LARGEST_CHANGE = 500.0
"""Change of an image above which it counts as that large, in the units of `Evidence.expected`; a
walking robot's median is 230. Few images then cannot outweigh all others."""
KEPT = 0.8
"""Share of the evidence that is kept when an image arrives: it spans about five images."""
STANDING = 500.0
"""Change that is added to that expected, so that a robot at rest has no evidence."""
START = 2500.0
"""Expected change with which a robot starts, none of it lacking: it does not know its motion yet,
and expects too much of the first images."""


class Recollection(NamedTuple):
    """What N robots know before an image arrives."""

    latent: Tensor
    """VP's latents h_v, [N, 64]."""
    history: Tensor
    """Proprioceptions o^{H1}, [N, H1, 45]. A short history's oldest stands for older ones."""
    blocks: Tensor
    """Blocks of the last image that VP was given, [N, 192] (see `mean_blocks`)."""
    age: Tensor
    """Time for which images have been withheld since then, [N] s."""


class Evidence(NamedTuple):
    """How much the last images of N robots should have changed, and what was lacking.

    Both are sums over blocks of squared depths, each divided by the expected variance of the error.
    """

    expected: Tensor
    """Sum of the expected changes' squares, [N]; 0 where a robot starts."""
    lacking: Tensor
    """Sum of the expected changes times what the images lack of them, [N]."""

    @property
    def stillness(self) -> Tensor:
        """Share of the expected change that is lacking, [N]: 0 if images move as the robot does,
        almost 1 if they stand still."""
        return self.lacking / (self.expected + STANDING)


def mean_blocks(image: Tensor) -> Tensor:
    """Compute the mean depth of each block of images, [..., 48, 64] to [..., 192]."""
    rows, columns = DEPTH_SHAPE
    means = F.avg_pool2d(image.reshape(-1, 1, rows, columns), BLOCK_SIDE)
    return means.reshape(*image.shape[:-2], BLOCKS)


class ImageExpectation(nn.Module):
    """Student's t-distribution of each block's depth in the next image.

    The distribution has heavy tails, because healthy images, too, differ greatly from what was
    expected now and then: a foot slips, an edge comes into view.
    """

    def __init__(self) -> None:
        super().__init__()
        inputs = LATENT + len(STEPS_BACK) * PROPRIOCEPTION_SIZE + 1
        self.motion = nn.Sequential(nn.Linear(inputs, MOTION), nn.ELU(inplace=True))
        self.change = nn.Sequential(
            nn.Linear(MOTION + BLOCKS, HIDDEN),
            nn.ELU(inplace=True),
            nn.Linear(HIDDEN, HIDDEN),
            nn.ELU(inplace=True),
            nn.Linear(HIDDEN, 2 * BLOCKS),
        )

    def forward(self, known: Recollection) -> tuple[Tensor, Tensor]:
        """Predict the blocks of the next image.

        Returns:
            Their depths, [N, 192], and the log variances of the errors, of the same shape.
        """
        oldest = known.history.shape[1] - 1
        proprioceptions = [known.history[:, -1 - min(steps, oldest)] for steps in STEPS_BACK]
        inputs = (known.latent, *proprioceptions, known.age.unsqueeze(-1))
        motion = self.motion(torch.cat(inputs, dim=-1))
        # Blocks around zero rather than around a half.
        output = self.change(torch.cat((motion, known.blocks - 0.5), dim=-1))
        change, log_variance = output.chunk(2, dim=-1)
        return known.blocks + change, (FIRST_BLOCK_LOG_VARIANCE + log_variance).clamp(
            *BLOCK_LOG_VARIANCE
        )

    def loss(self, known: Recollection, blocks: Tensor) -> Tensor:
        """Compute the mean negative log-likelihood of each image's blocks, [N], up to a constant.

        Args:
            known: What the robots know.
            blocks: Blocks of the images, [N, 192].
        """
        expected, log_variance = self(known)
        unlikeliness = _unlikeliness(blocks, expected, log_variance)
        return (0.5 * (FREEDOM + 1.0) * unlikeliness + 0.5 * log_variance).mean(dim=-1)

    def weigh(self, known: Recollection, blocks: Tensor, evidence: Evidence) -> Evidence:
        """Add new images to the evidence of earlier ones.

        Args:
            known: What the robots know.
            blocks: Blocks of the images, [N, 192].
            evidence: Evidence of the images before.
        """
        expected_blocks, log_variance = self(known)
        # Changes and errors in standard deviations of the expected error.
        deviation = (0.5 * log_variance).exp()
        change = (expected_blocks - known.blocks) / deviation
        error = ((expected_blocks - blocks) / deviation).clamp(-LARGEST_ERROR, LARGEST_ERROR)
        expected = change.square().sum(dim=-1)
        lacking = (change * error).sum(dim=-1)
        weight = LARGEST_CHANGE / expected.clamp_min(LARGEST_CHANGE)
        # Robots without evidence begin with that of images that moved.
        before = torch.where(evidence.expected > 0.0, evidence.expected, START)
        return Evidence(
            KEPT * before + weight * expected,
            KEPT * evidence.lacking + weight * lacking,
        )

    def surprise(self, known: Recollection, blocks: Tensor) -> Tensor:
        """Score images by how much they contradict what was expected, [N]; about 0.3 if healthy.

        Args:
            known: What the robots know.
            blocks: Blocks of the images, [N, 192].
        """
        return _unlikeliness(blocks, *self(known)).mean(dim=-1)


def _unlikeliness(blocks: Tensor, expected: Tensor, log_variance: Tensor) -> Tensor:
    """Compute the logarithm of the t-distribution's density, but for factors, [N, 192]."""
    ratio = (blocks - expected).square() / log_variance.exp()
    return torch.log1p(ratio / FREEDOM)
