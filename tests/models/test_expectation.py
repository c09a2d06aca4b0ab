"""The expectation of images: its likelihood against PyTorch's, and what it makes of lies."""

from itertools import pairwise

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.distributions import StudentT

from renet.models.expectation import (
    BLOCKS,
    FREEDOM,
    Evidence,
    ImageExpectation,
    Recollection,
    mean_blocks,
)


def recollection(images: Tensor, age: float = 0.0) -> Recollection:
    """What robots that stand still know, whose last images were these, [N, 48, 64]."""
    robots = len(images)
    return Recollection(
        latent=torch.zeros(robots, 64),
        history=torch.zeros(robots, 10, 45),
        blocks=mean_blocks(images),
        age=torch.full((robots,), age),
    )


def slopes(robots: int) -> Tensor:
    """Images of planes that are nearer on one side, [N, 48, 64]."""
    across = torch.linspace(0.0, 1.0, 64).expand(48, 64)
    down = torch.linspace(1.0, 0.0, 48).unsqueeze(1).expand(48, 64)
    left, far = torch.rand(2, robots, 1, 1)
    return 0.2 + 0.3 * left * across + 0.4 * far * down


def test_blocks_are_means_of_four_by_four_pixels():
    images = np.random.default_rng(0).random((2, 3, 48, 64))
    expected = images.reshape(2, 3, 12, 4, 16, 4).mean(axis=(3, 5)).reshape(2, 3, BLOCKS)
    np.testing.assert_allclose(mean_blocks(torch.tensor(images)), expected, atol=1e-12)


def test_the_loss_is_a_likelihood_and_the_surprise_its_part_that_grows_with_the_error():
    torch.manual_seed(0)
    expectation = ImageExpectation().eval()
    known = recollection(torch.rand(5, 48, 64))
    blocks = torch.rand(2, 5, BLOCKS)
    expected, log_variance = expectation(known)
    density = StudentT(FREEDOM, expected, (0.5 * log_variance).exp())
    likelihoods = torch.stack([density.log_prob(each).mean(-1) for each in blocks])
    losses = torch.stack([expectation.loss(known, each) for each in blocks])
    torch.testing.assert_close(losses[0] - losses[1], likelihoods[1] - likelihoods[0])

    assert torch.equal(expectation.surprise(known, expected), torch.zeros(5))
    surprises = torch.stack([expectation.surprise(known, each) for each in blocks])
    change = 0.5 * (FREEDOM + 1.0) * (surprises[0] - surprises[1])
    torch.testing.assert_close(losses[0] - losses[1], change)


def test_it_reads_the_motion_now_a_tick_ago_and_when_a_late_image_was_taken():
    expectation = ImageExpectation()
    known = recollection(torch.rand(1, 48, 64))
    history = known.history.requires_grad_()
    expectation.loss(known._replace(history=history), torch.rand(1, BLOCKS)).sum().backward()
    read = history.grad.abs().sum(dim=(0, 2)).nonzero().flatten()
    assert read.tolist() == [1, 4, 9]


def test_mirrored_and_scaled_images_surprise_who_has_learned_that_images_stay():
    torch.manual_seed(0)
    expectation = ImageExpectation()
    optimizer = torch.optim.Adam(expectation.parameters(), lr=3e-3)
    for _ in range(300):
        images = slopes(64)
        seen = images + 0.01 * torch.randn(64, 48, 64)
        loss = expectation.loss(recollection(images), mean_blocks(seen)).mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()

    images = slopes(200)
    known = recollection(images)
    healthy = expectation.surprise(known, mean_blocks(images + 0.01 * torch.randn_like(images)))
    for lie in (images.flip(-1), 1.3 * images, torch.roll(images, 12, dims=1)):
        surprise = expectation.surprise(known, mean_blocks(lie))
        assert (surprise > healthy.max()).float().mean() > 0.8


class Approach(ImageExpectation):
    """Expectation of images that come nearer by a constant in each step, to 1 cm of 2 m."""

    STEP = 0.02

    def forward(self, known: Recollection) -> tuple[Tensor, Tensor]:
        expected = known.blocks - self.STEP
        return expected, torch.full_like(expected, 2.0 * np.log(0.005))


def stillness(images: list[Tensor], expectation: ImageExpectation) -> list[float]:
    """Stillness after each image but the first, of one robot."""
    evidence = Evidence(torch.zeros(1), torch.zeros(1))
    found = []
    for last, image in pairwise(images):
        evidence = expectation.weigh(recollection(last), mean_blocks(image), evidence)
        found.append(evidence.stillness.item())
    return found


def test_images_that_stand_still_lack_the_change_and_those_that_move_do_not():
    torch.manual_seed(0)
    moving = [slopes(1) * 0 + 0.9 - Approach.STEP * step for step in range(9)]
    moving = [image + 0.005 * torch.randn_like(image) for image in moving]
    still = moving[:1] * 9
    half = [torch.cat((moving[0][:, :24], image[:, 24:]), dim=1) for image in moving]
    # The change in standard deviations, 4, is squared and summed over 192 blocks in each step; more
    # than 500 counts as that. An error counts as at most 3 standard deviations.
    kept = sum(0.8**age for age in range(8))
    most = 0.75 * 500.0 * kept / (500.0 * kept + 2500.0 * 0.8**8 + 500.0)
    # The first image of a robot that starts says little.
    first = 0.75 * 500.0 / (500.0 + 2500.0 * 0.8 + 500.0)
    assert stillness(still[:2], Approach()) == pytest.approx([first])
    assert max(stillness(moving, Approach())) < 0.05
    assert stillness(still, Approach())[-1] == pytest.approx(most, rel=1e-5)
    assert stillness(half, Approach())[-1] == pytest.approx(0.5 * most, abs=0.02)
    # Images that move again are soon believed.
    recovered = stillness(still + [image - 0.3 for image in moving], Approach())
    assert recovered[-1] < 0.25 * most


def test_a_robot_at_rest_has_no_evidence_of_stillness():
    class Rest(Approach):
        STEP = 0.0

    image = slopes(1)
    assert stillness([image] * 20, Rest()) == [0.0] * 19
