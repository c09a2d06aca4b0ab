"""Loss_OP and Loss_VP (RENet eq. 1 and 2) against sums written out."""

import math

import numpy as np
import pytest
import torch

import renet.training.supervision as supervision_module
from renet.models.config import ModelCfg
from renet.models.expectation import BLOCKS, Recollection
from renet.models.him import target_view
from renet.models.renet import RENet
from renet.training.config import SupervisionCfg
from renet.training.storage import TickRollout
from renet.training.supervision import Supervision

TICKS, ROBOTS = 3, 4


@pytest.fixture
def rollout() -> TickRollout:
    return random_rollout()


def random_rollout(ticks: int = TICKS) -> TickRollout:
    """Of four robots, of which OP drives the first two; some images are missing."""
    torch.manual_seed(1)
    no = torch.zeros(ticks, ROBOTS, dtype=torch.bool)
    sizes = {"velocity": 3, "height_map": 132, "next_proprioception": 45, "next_velocity": 3}
    sizes |= {"far_map": 30, "latent_op": 64, "latent_vp": 64}
    sizes |= {"blocks": BLOCKS, "last_blocks": BLOCKS}
    return TickRollout(
        history=torch.randn(ticks, ROBOTS, 10, 45),
        frames=torch.rand(ticks, ROBOTS, 2, 48, 64).half(),
        has_image=torch.rand(ticks, ROBOTS) < 0.7,
        fresh=no,
        op_mask=(torch.arange(ROBOTS) < 2).expand_as(no).clone(),
        feet_height=torch.rand(ticks, ROBOTS, 4),
        image_age=torch.rand(ticks, ROBOTS),
        next_valid=~no,
        **{name: torch.randn(ticks, ROBOTS, size) for name, size in sizes.items()},
    )


@pytest.fixture
def model() -> RENet:
    torch.manual_seed(0)
    return RENet(ModelCfg(), critic_size=5).eval()


def losses_of(name: str, model: RENet, rollout: TickRollout) -> dict[str, torch.Tensor]:
    return Supervision(model, SupervisionCfg()).estimator_losses(name, rollout)


def replay(name: str, model: RENet, rollout: TickRollout) -> list[torch.Tensor]:
    """Latents of all robots, tick by tick as in flight."""
    estimator, latent = getattr(model, name), getattr(rollout, f"latent_{name}")[0]
    latents = []
    for tick in range(TICKS):
        images = rollout.frames[tick].float(), rollout.has_image[tick]
        latent = estimator(rollout.history[tick], *images, latent)
        latents.append(latent)
    return latents


@pytest.mark.parametrize("name", ["op", "vp"])
def test_losses_match_heads_and_him(model, rollout, name):
    """Eq. 1 has the velocity, to which eq. 2 adds feet height and height map."""
    heads = ["velocity"] if name == "op" else ["velocity", "feet_height", "height_map"]
    robots = slice(2) if name == "op" else slice(2, ROBOTS)
    losses = losses_of(name, model, rollout)
    assert set(losses) == {f"{name}_{term}" for term in (*heads, "him")}
    latents = torch.stack(replay(name, model, rollout))[:, robots]
    for head in heads:
        error = getattr(model, name).predict(latents)[head] - getattr(rollout, head)[:, robots]
        expected = error.square().mean().item()
        assert losses[f"{name}_{head}"].item() == pytest.approx(expected, rel=1e-4)
    following = target_view(rollout.next_proprioception, rollout.next_velocity)[:, robots]
    pairs = latents.flatten(0, 1), following.flatten(0, 1)
    him = getattr(model, f"{name}_him")(*pairs, torch.ones(len(pairs[0])))
    assert losses[f"{name}_him"].item() == pytest.approx(him.item(), rel=1e-4)


def test_vp_learns_far_map(rollout):
    torch.manual_seed(0)
    model = RENet(ModelCfg(predict_far_map=True), critic_size=5).eval()
    losses = losses_of("vp", model, rollout)
    latents = torch.stack(replay("vp", model, rollout))[:, 2:]
    error = model.vp.predict(latents)["far_map"] - rollout.far_map[:, 2:]
    assert losses["vp_far_map"].item() == pytest.approx(error.square().mean().item(), rel=1e-4)
    losses["vp_far_map"].backward()
    # Memory is what is to learn it.
    assert model.vp.gru.weight_hh.grad.abs().sum() > 0


def test_total_loss_is_scaled_sum(model, rollout):
    cfg = SupervisionCfg(num_learning_epochs=1, num_mini_batches=1)
    supervision = Supervision(model, cfg)
    (batch,) = supervision.draw_mini_batches(rollout)
    losses = supervision._blind_losses(rollout, batch) | supervision._vp_losses(rollout, batch)
    squared = {"velocity": 4.0, "feet_height": 25.0, "height_map": 25.0}
    total = sum(squared.get(name[3:], 1.0) * loss for name, loss in losses.items())
    gradients = torch.autograd.grad(total, supervision.parameters)
    steps = []
    supervision.optimizer.step = lambda: steps.append([p.grad for p in supervision.parameters])
    supervision.cfg.max_grad_norm = float("inf")
    supervision.update(rollout)
    # Images of the autoencoder are drawn anew; all other gradients are the same.
    drawn = len(list(model.autoencoder.parameters()))
    for expected, got in zip(gradients[:-drawn], steps[0][:-drawn], strict=True):
        torch.testing.assert_close(got, expected, atol=1e-5, rtol=1e-3)


def test_him_ignores_episode_ends(model, rollout):
    before = losses_of("op", model, rollout)
    rollout.next_valid[1, 0] = False
    rollout.next_proprioception[1, 0] = 1e3  # The next episode's first observation.
    after = losses_of("op", model, rollout)
    assert torch.isfinite(after["op_him"])
    assert after["op_velocity"] == before["op_velocity"]
    assert after["op_him"] < 2 * before["op_him"]


@pytest.mark.parametrize("idle", ["op", "vp"])
def test_momentum_leaves_idle_estimator(model, rollout, idle):
    supervision = Supervision(model, SupervisionCfg(num_mini_batches=1))
    supervision.update(rollout)  # Both drive: both have momentum.
    rollout.op_mask[:] = idle == "vp"
    still = [*getattr(model, idle).parameters(), *getattr(model, f"{idle}_him").parameters()]
    before = [p.clone() for p in still]
    supervision.update(rollout)
    assert all(torch.equal(a, b) for a, b in zip(before, still, strict=True))


def test_rate_follows_schedule(model, rollout):
    supervision = Supervision(model, SupervisionCfg(learning_rate="1e-3@1M,1e-4@3M"))
    losses = supervision.update(rollout, steps=2_000_000)
    assert supervision.optimizer.param_groups[0]["lr"] == pytest.approx(5.5e-4)
    for name in ("op", "vp"):
        assert 8 < losses[f"{name}_him_rank"] <= 16  # Random prototypes point everywhere.
        assert 1 <= losses[f"{name}_him_usage"] <= 32


@pytest.mark.parametrize(
    ("detector", "pairs", "learned", "overgrown"),
    [("reconstruction", 12, 5, 0), ("reconstruction", 120, 40, 0), ("variance", 120, 40, 6)],
)
def test_detectors_learn_from_a_share(monkeypatch, detector, pairs, learned, overgrown):
    model, taken = RENet(ModelCfg(detector=detector), critic_size=5), []
    monkeypatch.setattr(model.autoencoder, "loss", lambda images: taken.append(images) or {})
    # Two fifths of 12 pairs are 4.8; of 120, the setting takes fewer.
    cfg = SupervisionCfg(num_mini_batches=1, autoencoder_images=40)
    supervision = Supervision(model, cfg)
    rollout = random_rollout(ticks=pairs // ROBOTS)
    rollout.frames[:], rollout.has_image[:] = 1.0, True
    supervision._anomaly_losses(rollout, *supervision.draw_mini_batches(rollout))
    assert len(taken[0]) == learned
    # A view may hold a single blade, beside the image.
    grown = (taken[0] < 1.0).flatten(1).any(1).sum()
    assert max(0, overgrown - 1) <= grown <= overgrown


def test_map_error_is_gaussian_likelihood(rollout):
    torch.manual_seed(0)
    model = RENet(ModelCfg(predict_map_error=True), critic_size=5)
    losses = losses_of("vp", model, rollout)
    latents = torch.stack(replay("vp", model, rollout))[:, 2:]  # OP drives the first two.
    wrong = (model.vp.predict(latents)["height_map"] - rollout.height_map[:, 2:]).detach()
    normal = torch.distributions.Normal(0.0, model.vp.map_log_variance(latents).exp().sqrt())
    expected = -normal.log_prob(wrong).mean() - 0.5 * math.log(2 * math.pi)
    torch.testing.assert_close(losses["vp_map_nll"], expected, atol=1e-5, rtol=1e-4)
    losses["vp_map_nll"].backward()
    moved = {n for n, p in model.named_parameters() if p.grad is not None and p.grad.any()}
    assert {name.rpartition(".")[0].rpartition(".")[0] for name in moved} == {"vp.map_error_head"}


def test_images_are_expected_from_each_tick_but_the_first_without_a_gradient_to_vp(rollout):
    model = RENet(ModelCfg(expect_image=True), critic_size=5)
    rollout.fresh[1, 2] = True
    supervision = Supervision(model, SupervisionCfg(num_mini_batches=1))
    (batch,) = supervision.draw_mini_batches(rollout)
    (loss,) = supervision._expectation_losses(rollout, batch).values()

    expected = []
    for tick in range(TICKS):
        parts = (rollout.latent_vp, rollout.history, rollout.last_blocks, rollout.image_age)
        known = Recollection(*(part[tick] for part in parts))
        losses = model.expectation.loss(known, rollout.blocks[tick])
        expected += losses[~rollout.fresh[tick]].tolist()
    assert len(expected) == TICKS * ROBOTS - 1
    assert loss.item() == pytest.approx(np.mean(expected), rel=1e-5)
    loss.backward()
    moved = {n.partition(".")[0] for n, p in model.named_parameters() if p.grad is not None}
    assert moved == {"expectation"}


def test_detector_ignores_withheld_images(model, rollout, monkeypatch):
    learned: list[torch.Tensor] = []
    rollout.frames[~rollout.has_image] = -1.0
    rollout.frames[rollout.has_image] = torch.rand(int(rollout.has_image.sum()), 1, 1, 1).half()
    monkeypatch.setattr(model.autoencoder, "loss", lambda p: learned.append(p) or {})
    monkeypatch.setattr(supervision_module, "AUTOENCODER_SHARE", 1.0)
    supervision = Supervision(model, SupervisionCfg(num_mini_batches=2))
    for batch in supervision.draw_mini_batches(rollout):
        supervision._blind_losses(rollout, batch)
    # Each once.
    seen = torch.cat(learned)[:, 0, 0, 0]
    expected = rollout.frames[rollout.has_image][:, 0, 0, 0].float()
    torch.testing.assert_close(seen.sort().values, expected.sort().values)
    rollout.has_image[:] = False
    supervision.update(rollout)
    assert len(learned) == 2


def test_mini_batches_hold_each_environment_once(model, rollout):
    rollout.op_mask[1, 3] = True  # Both estimators drive the last robot.
    batches = Supervision(model, SupervisionCfg(num_mini_batches=3)).draw_mini_batches(rollout)
    assert sorted(torch.cat([batch.index for batch in batches]).tolist()) == [0, 1, 2, 3]
    for batch in batches:
        robots = batch.index.tolist()
        assert batch.op.tolist() == [robot for robot in robots if robot in (0, 1, 3)]
        assert batch.vp.tolist() == [robot for robot in robots if robot in (2, 3)]
        assert batch.images == rollout.has_image[:, batch.index].sum()
        learns = {"op": len(batch.op), "vp": len(batch.vp), "detector": batch.images}
        assert batch.learners == [part for part, size in learns.items() if size]
