"""The mean of checkpoints, written by hand and by training."""

from __future__ import annotations

import pytest
import torch

from renet.errors import RenetError
from renet.training import checkpoint as checkpoints
from renet.training.average import AverageCfg, average
from renet.training.checkpoint import Checkpoint

from .test_runner import make_runner


def write(folder, iteration: int, **weights: list[float]) -> None:
    model = {name: torch.tensor(values) for name, values in weights.items()}
    moments = {"np3o/0/step": torch.tensor(3.0)}
    levels = {"levels": torch.tensor([iteration])}
    checkpoints.save(Checkpoint(model, moments, levels), folder, iteration, keep=9)


def test_weights_are_averaged_and_all_else_is_the_newest(tmp_path):
    run = tmp_path / "run"
    for iteration, weights in enumerate(([9.0, 9.0], [1.0, -2.0], [2.0, 2.0], [6.0, 3.0])):
        write(run / "checkpoints", iteration, weight=weights, count=[iteration])
    made = average(AverageCfg(run=run, last=3, out=tmp_path / "mean"))
    loaded = checkpoints.load(made)
    assert loaded.model["weight"].tolist() == [3.0, 1.0]
    assert loaded.model["count"].tolist() == [3]
    assert loaded.environment["levels"].tolist() == [3]
    assert loaded.state["iteration"] == 3
    assert loaded.optimizer == {}
    assert checkpoints.find(tmp_path / "mean") == made


def test_training_goes_on_from_the_mean(toy_env, tmp_path):
    runner = make_runner(toy_env(), tmp_path / "run")
    runner.learn(5)
    made = average(AverageCfg(run=tmp_path / "run", out=tmp_path / "mean"))
    expected = [
        checkpoints.load(path).model["actor.log_std"]
        for path in checkpoints.checkpoints(tmp_path / "run" / "checkpoints")
    ]
    assert len(expected) == 3
    resumed = make_runner(toy_env(), tmp_path / "next")
    resumed.load(str(made))
    mean = torch.stack(expected).mean(0)
    torch.testing.assert_close(resumed.alg.model.actor.log_std.detach(), mean)
    resumed.learn(1)


@pytest.mark.parametrize(("last", "has"), [(3, 2), (1, 2), (None, 1), (None, 0)])
def test_too_few_checkpoints_are_refused(tmp_path, last, has):
    for iteration in range(has):
        write(tmp_path / "run", iteration, weight=[1.0])
    with pytest.raises(RenetError, match=f"has {has}, and it takes two"):
        average(AverageCfg(run=tmp_path / "run", last=last, out=tmp_path / "mean"))
    assert not (tmp_path / "mean").exists()


def test_checkpoints_of_different_models_are_refused_by_name(tmp_path):
    write(tmp_path / "run", 1, weight=[1.0])
    write(tmp_path / "run", 2, weight=[1.0, 2.0])
    with pytest.raises(RenetError, match=r"it_00000001 is of another architecture: weight is \(1,"):
        average(AverageCfg(run=tmp_path / "run", out=tmp_path / "mean"))


def test_no_checkpoint_is_overwritten(tmp_path):
    for iteration in (1, 2):
        write(tmp_path, iteration, weight=[1.0])
    with pytest.raises(RenetError, match="choose another --out"):
        average(AverageCfg(run=tmp_path, out=tmp_path))
