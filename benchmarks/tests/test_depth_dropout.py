"""Cameras fail as often and as badly as asked, and a run that is resumed goes on with them."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from tests.training.conftest import ToyEnv, make_runner, single_precision  # noqa: F401  of all tests

from baselines import depth_dropout
from baselines.depth_dropout import DepthDropout, DepthDropoutCfg, spoil_depth
from renet.bundle import Bundle
from renet.cli import parse
from renet.errors import RenetError
from renet.interface import CONTROL_DT
from renet.training.train import TrainCfg, train


def test_fails_for_the_stated_share_of_time_and_mean_length() -> None:
    torch.manual_seed(0)
    dropout = DepthDropout(DepthDropoutCfg(0.3, 0.5), 400, 0.02, "cpu")
    states = []
    for _ in range(1500):
        dropout(torch.zeros(400, 2, 2))
        states.append(dropout.kind > 0)
    failing = torch.stack(states[500:])
    assert failing.float().mean().item() == pytest.approx(0.3, abs=0.02)
    begun = (failing[1:] & ~failing[:-1]).sum()
    assert (failing.sum() / begun * 0.02).item() == pytest.approx(0.5, rel=0.05)


def test_each_kind_spoils_as_it_says_and_healthy_images_stay() -> None:
    torch.manual_seed(0)
    dropout = DepthDropout(DepthDropoutCfg(0.6, 1.0), 2000, 0.02, "cpu")
    image = torch.full((2000, 48, 64), 0.5)
    for _ in range(60):
        after = dropout(image)
    assert set(dropout.kind.tolist()) == {0, 1, 2, 3}
    assert (after[dropout.kind == 0] == 0.5).all()
    assert (after[dropout.kind == 1] == 0).all()
    boxes = after[dropout.kind == 2]
    assert set(boxes.unique().tolist()) == {0.0, 0.5}
    hidden = (boxes == 0).float().mean(dim=0).unflatten(1, (2, 32)).unflatten(0, (2, 24))
    # A pixel at the share x of an axis is covered with probability 2 x (1 - x), 1/3 on average.
    torch.testing.assert_close(
        hidden.mean(dim=(1, 3)), torch.full((2, 2), 1 / 9), atol=0.03, rtol=0
    )
    noisy = after[dropout.kind == 3]
    assert noisy.std() > 0.3
    assert 0 <= noisy.min() <= noisy.max() <= 1


def test_trains_and_only_the_depth_image_differs() -> None:
    torch.manual_seed(0)
    plain = ToyEnv(8, seed=3)
    spoilt = ToyEnv(8, seed=3)
    spoil_depth(spoilt, DepthDropoutCfg(0.5, 0.1), 0.02)
    changed = False
    for _ in range(30):
        mine, its = spoilt.step(torch.zeros(8, 12)), plain.step(torch.zeros(8, 12))
        for name, value in its[0].items():
            same = torch.equal(value, mine[0][name])
            assert same or name == "depth"
            changed |= not same
        assert torch.equal(mine[2], its[2])
    assert changed
    make_runner(spoilt, num_steps_per_env=25).learn(1)


@pytest.mark.parametrize("wrong", [{"share": 1.0}, {"share": -0.1}, {"seconds": 0.0}])
def test_impossible_settings_are_refused(wrong) -> None:
    with pytest.raises(RenetError, match="depth dropout"):
        DepthDropoutCfg(**wrong)


def test_a_run_spoils_its_environment_and_goes_on_with_its_settings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    spoilt: list = []
    monkeypatch.setattr(depth_dropout, "spoil_depth", lambda *what: spoilt.append(what[1:]))
    small = TrainCfg.from_task(depth_dropout.TASK, device="cpu", log_root=tmp_path)
    small.env.scene.num_envs = 4
    dropout = DepthDropoutCfg(0.3, 0.5)
    changes = {"depth_dropout": dropout, "num_steps_per_env": 5, "max_iterations": 1}
    run = train(replace(small, agent=replace(small.agent, **changes)))
    assert spoilt == [(dropout, CONTROL_DT)]
    again = parse(TrainCfg, [depth_dropout.TASK, "--resume", str(run)], "")
    assert again.agent.depth_dropout == dropout
    script, bundle = Path(depth_dropout.__file__).parents[1] / "baseline.py", tmp_path / "bundle"
    subprocess.run([sys.executable, script, "export", run, "--out", bundle], check=True)
    assert Bundle.load(bundle).manifest.provenance.task == depth_dropout.TASK
