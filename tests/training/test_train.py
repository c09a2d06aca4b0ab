"""What `renet train` does around the loop: folders, settings, devices, and going on."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
import torch

from renet.errors import RenetError
from renet.training import checkpoint as checkpoints
from renet.training import train as training
from renet.training.checkpoint import Checkpoint
from renet.training.train import (
    TrainCfg,
    _switch_step,
    new_run,
    record_config,
    resolve_device,
    resumed_run,
    train,
)


def cfg(folder: Path, task: str = "Renet-Go1-Flat", **overrides) -> TrainCfg:
    small = {"num_envs": 4, "device": "cpu", "num_steps_per_env": 5, "log_root": folder}
    return TrainCfg(task=task, **(small | {"max_iterations": 1} | overrides))


def test_another_task_leaves_the_run_it_goes_on_from_alone(tmp_path):
    flat = train(cfg(tmp_path))
    assert flat is not None
    checkpoint = flat / "checkpoints" / "it_00000001"
    before = sorted(flat.rglob("*"))
    assert resumed_run(checkpoint) == flat
    parkour = train(cfg(tmp_path, "Renet-Go1-Parkour", resume=str(checkpoint), max_iterations=2))
    assert parkour is not None
    assert sorted(flat.rglob("*")) == before
    assert parkour.parent == tmp_path / "Renet-Go1-Parkour"
    assert checkpoints.find(parkour).name == "it_00000002"
    with pytest.raises(RenetError, match=r"not in --log-root .*elsewhere: leave out"):
        train(cfg(tmp_path / "elsewhere", resume=str(checkpoint), max_iterations=2))
    assert sorted(flat.rglob("*")) == before
    with pytest.raises(RenetError, match="is at iteration 2: --max-iterations counts from"):
        train(cfg(tmp_path, "Renet-Go1-Parkour", resume="latest", max_iterations=2))


def test_the_second_level_of_commands_keeps_its_iteration_when_rollouts_get_longer(tmp_path):
    counter = torch.tensor(2000 * 25)
    resumed = Checkpoint({}, {}, {"common_step_counter": counter}, {"task": ""})
    resumed.state["iteration"] = 2000
    longer = cfg(tmp_path, num_steps_per_env=50, standing_after=4000)
    assert _switch_step(longer, None) == 4000 * 50
    assert _switch_step(longer, resumed) == 2000 * 25 + 2000 * 50


def test_what_changes_in_a_run_that_goes_on_is_said_and_kept(tmp_path, capsys):
    record_config(cfg(tmp_path, reward_weights={"collision": -1.0}), tmp_path)
    assert capsys.readouterr().out == ""
    record_config(cfg(tmp_path, seed=3, resume="latest"), tmp_path)
    assert capsys.readouterr().out.splitlines() == [
        "reward_weights.collision was -1.0, now default",
        "seed was 1, now 3",
    ]
    assert json.loads((tmp_path / "config.json").read_text())["seed"] == 3


def test_runs_begun_in_the_same_second_have_folders_of_their_own(tmp_path):
    assert len({new_run(tmp_path, "task") for _ in range(3)}) == 3


def test_a_process_gets_its_own_gpu_or_is_told(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    monkeypatch.setenv("LOCAL_RANK", "1")
    assert resolve_device("auto") == resolve_device("cuda") == "cuda:1"
    monkeypatch.setenv("LOCAL_RANK", "2")
    with pytest.raises(RenetError, match="cuda:2 is absent: 2 CUDA devices"):
        resolve_device("auto")


def test_the_time_budget_counts_from_the_start(tmp_path, monkeypatch):
    given = []
    monkeypatch.setattr(
        training.RenetRunner, "learn", lambda self, n, time_budget_s: given.append(time_budget_s)
    )
    train(cfg(tmp_path, time_budget="60s"))
    assert 0.0 < given[0] < 59.9


def test_the_newest_checkpoint_is_the_highest_iteration_of_the_last_run(tmp_path, capsys):
    """Not the file touched last: copying or syncing a run touches them in any order."""
    names = ("2026-01-01_10-00-00", 9), ("2026-01-02_10-00-00", 3), ("2026-01-02_10-00-00", 12)
    for age, (run, iteration) in enumerate(names):
        folder = tmp_path / run / "checkpoints" / f"it_{iteration:08d}"
        folder.mkdir(parents=True)
        (folder / "state.json").write_text("{}")
        os.utime(folder, (1000 - age, 1000 - age))
    (tmp_path / "2026-01-03" / "it_final").mkdir(parents=True)
    (tmp_path / "2026-01-03" / "it_final" / "state.json").write_text("{}")
    found = checkpoints.find(tmp_path)
    assert (found.parent.parent.name, found.name) == ("2026-01-02_10-00-00", "it_00000012")
    assert f"Checkpoint: {found}\n" == capsys.readouterr().out
