"""Several processes from one command."""

import json

import pytest

from renet.errors import RenetError
from renet.training.launch import launch

from .test_train import cfg


def test_two_processes_train_one_model(tmp_path):
    run = launch(cfg(tmp_path, processes=2))
    assert run is not None
    checkpoint = run / "checkpoints" / "it_00000001"
    assert (checkpoint / "model.safetensors").exists()
    # Twice four robots for five steps: both processes' work counts.
    assert json.loads((checkpoint / "state.json").read_text())["steps"] == 2 * 4 * 5
    assert len(list((tmp_path / "workers").glob("*/localhost[[]?].log"))) == 2


def test_a_process_that_fails_ends_those_that_wait_for_it(tmp_path):
    (tmp_path / "Renet-Go1-Flat").touch()  # Rank 0 cannot make its folder there.
    with pytest.raises(RenetError, match="a process failed"):
        launch(cfg(tmp_path, processes=2))


@pytest.mark.parametrize("wrong", [{"processes": 0}, {"hosts": ()}])
def test_nobody_to_train_is_an_error(tmp_path, wrong):
    with pytest.raises(RenetError, match="--processes"):
        launch(cfg(tmp_path, **wrong))
