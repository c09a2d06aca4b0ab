"""Estimators: unrolling, memory across resets and flips, and what each one may see."""

import pytest
import torch

from renet.models.adaptation import fuse
from renet.models.config import ModelCfg
from renet.models.memory import EstimatorMemory
from renet.models.renet import RENet


@pytest.fixture(params=["attention", "mlp"])
def model(request):
    torch.manual_seed(0)
    return RENet(ModelCfg(encoder=request.param), critic_size=5).eval()


def test_unrolling_equals_ticking_by_hand_with_resets(model):
    history, depth = torch.randn(6, 3, 10, 45), torch.rand(6, 3, 2, 48, 64)
    fresh = torch.zeros(6, 3, dtype=torch.bool)
    fresh[2, 0] = fresh[4, 1] = fresh[0, 2] = True
    has_image = torch.rand(6, 3) < 0.5
    start = torch.randn(3, 64)
    for estimator in (model.op, model.vp):
        got = estimator.unroll(history, depth, has_image, start, fresh)
        latent = start
        for tick in range(6):
            latent = torch.where(fresh[tick][:, None], torch.zeros_like(latent), latent)
            latent = estimator(history[tick], depth[tick], has_image[tick], latent)
            torch.testing.assert_close(got[tick], latent, atol=1e-5, rtol=1e-4)


def test_gradients_stop_at_resets(model):
    history = torch.randn(3, 2, 10, 45, requires_grad=True)
    fresh = torch.tensor([[False, False], [False, True], [False, False]])
    images = torch.rand(3, 2, 2, 48, 64), torch.ones(3, 2)
    latents = model.op.unroll(history, *images, torch.zeros(2, 64), fresh)
    latents[-1].sum().backward()
    reached = history.grad[0].abs().sum((1, 2)) > 0
    assert reached.tolist() == [True, False]


def test_op_never_sees_depth_and_vp_does(model):
    """VP only where the image was not withheld, which then says nothing, whatever it shows."""
    history, latent = torch.randn(2, 10, 45), torch.randn(2, 64)
    one, two = torch.rand(2, 2, 48, 64), torch.rand(2, 2, 48, 64)
    yes, no = torch.ones(2), torch.zeros(2)

    def same(estimator, first, second) -> bool:
        return torch.equal(estimator(history, *first, latent), estimator(history, *second, latent))

    assert same(model.op, (one, yes), (two, no))
    assert not same(model.vp, (one, yes), (two, yes))
    assert same(model.vp, (one, no), (two, no))
    assert not same(model.vp, (one, no), (one, yes))


def test_map_error_needs_a_map():
    blind = RENet(ModelCfg(predict_map_error=True, predict_height_map=False), critic_size=5)
    assert blind.vp.map_error_head is None


def test_fuse_is_the_papers_equation():
    op, vp = torch.ones(2, 64), 2 * torch.ones(2, 64)
    fused = fuse(op, vp, torch.tensor([True, False]))
    assert torch.equal(fused[0], torch.cat((torch.ones(64), torch.zeros(64))))
    assert torch.equal(fused[1], torch.cat((torch.zeros(64), 2 * torch.ones(64))))


def test_memory_fills_and_resets(model):
    memory = EstimatorMemory(model.cfg, 2, "cpu")
    first = torch.randn(2, 45)
    memory.push(first)
    assert torch.equal(memory.history, first[:, None].expand(2, 10, 45))
    image = torch.rand(2, 48, 64)
    memory.see(image)
    assert torch.equal(memory.frames[:, 0], memory.frames[:, 1])
    memory.tick(model.advance)
    assert memory.latent_op.abs().sum() > 0
    memory.reset(torch.tensor([True, False]))
    assert memory.latent_op[0].abs().sum() == 0
    assert memory.latent_vp[1].abs().sum() > 0
    second = torch.randn(2, 45)
    memory.push(second)
    memory.see(torch.rand(2, 48, 64))
    assert torch.equal(memory.history[0], second[0].expand(10, 45))
    assert torch.equal(memory.history[1, -2], first[1])
    assert torch.equal(memory.frames[0, 0], memory.frames[0, 1])
    assert torch.equal(memory.frames[1, 1], image[1].half())


def test_image_after_withholding_fills_both_frames(model):
    memory, images = EstimatorMemory(model.cfg, 2, "cpu"), torch.rand(4, 2, 48, 64)
    memory.push(torch.randn(2, 45))
    lost = torch.tensor([True, False])  # The first robot loses its images at ticks 1 and 2.
    pairs, ages = [], []
    for tick, image in enumerate(images):
        memory.see(image, ~lost if tick in (1, 2) else None)
        memory.tick(model.advance)
        pairs.append(memory.frames.float())
        ages.append(memory.image_age.tolist())
    images = images.half().float()
    assert torch.equal(pairs[2][0], pairs[0][0])
    assert torch.equal(pairs[3][0], images[3, 0].expand(2, 48, 64))
    assert torch.equal(pairs[3][1], torch.stack((images[3, 1], images[2, 1])))
    assert ages == [[0, 0], [pytest.approx(0.1), 0], [pytest.approx(0.2), 0], [0, 0]]
    memory.see(images[0], ~lost)
    memory.reset(torch.tensor([True, False]))
    assert memory.image_age.tolist() == [0, 0]
