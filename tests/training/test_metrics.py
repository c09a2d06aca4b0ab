"""Curves on disk."""

import json
import sys

import pytest

from renet.errors import RenetError
from renet.training.metrics import CURVES, CurvesWriter, level_curves, read_curves

from .conftest import ToyEnv, make_runner


def test_a_resumed_runs_last_value_counts(tmp_path):
    for value in (1.0, 2.0):
        writer = CurvesWriter(str(tmp_path), "tensorboard", "")
        writer.add_scalar("Loss/value", value, 7)
        writer.stop()
    assert read_curves(tmp_path) == {"Loss/value": ([7], [2.0])}


def test_a_file_that_cannot_be_opened_and_a_full_disk_are_named(tmp_path, monkeypatch):
    (tmp_path / CURVES).mkdir()
    with pytest.raises(RenetError, match="cannot write the curves"):
        CurvesWriter(str(tmp_path), "tensorboard", "")
    full = open("/dev/full", "a", buffering=1)  # noqa: SIM115  It closes it.
    monkeypatch.setattr("renet.training.metrics.append", lambda _: full)
    with pytest.raises(RenetError, match=r"cannot write the curves .*No space left"):
        CurvesWriter(str(tmp_path), "tensorboard", "")


def test_a_row_torn_by_a_power_cut_costs_itself_alone(tmp_path):
    writer = CurvesWriter(str(tmp_path), "tensorboard", "")
    writer.add_scalar("Loss/value", 1.0, 1)
    writer.stop()
    with (tmp_path / CURVES).open("a") as file:
        file.write("2,Loss/val")
    writer = CurvesWriter(str(tmp_path), "tensorboard", "")
    writer.add_scalar("Loss/value", 3.0, 3)
    writer.stop()
    assert read_curves(tmp_path) == {"Loss/value": ([1, 3], [1.0, 3.0])}


@pytest.mark.parametrize("form", [1, 2])
def test_levels_over_steps_follow_the_batches_schedule(tmp_path, form):
    agent = {"num_steps_per_env": None, "batch_size": "2500@5000,5000@10000"}
    config = {"agent": agent, "env": {"scene": {"num_envs": 100}}}
    config = config if form == 2 else agent | {"num_envs": 100}
    (tmp_path / "config.json").write_text(json.dumps(config))
    lines = ["iteration,name,value"]
    for number in range(4):
        lines += [f"{number},Perf/total_fps,1000", f"{number},Curriculum/level/gap,{number}"]
    (tmp_path / CURVES).write_text("\n".join(lines) + "\n")
    # Batches of 25, 25, 25 and 40 steps (a multiple of 5 that is at least 37.5) of each robot.
    assert level_curves(tmp_path, every=2) == [
        {"steps": 5000, "hours": 0.001, "gap": 0.5},
        {"steps": 11500, "hours": 0.003, "gap": 2.5},
    ]
    late = level_curves(tmp_path, steps=20000, every=4)
    assert [row["steps"] for row in late] == [20000 + 4 * 5000]


def test_curves_go_to_wandb_offline_beside_the_file(tmp_path, monkeypatch):
    """The run's own process would wait for the network; offline it writes a folder."""
    wandb = pytest.importorskip("wandb")
    for name, value in {"MODE": "offline", "DIR": str(tmp_path), "SILENT": "true"}.items():
        monkeypatch.setenv(f"WANDB_{name}", value)
    runner = make_runner(ToyEnv(), tmp_path, logger="wandb")
    runner.learn(2)
    wandb.teardown()  # Its service writes what is left.
    (log,) = (tmp_path / "wandb").glob("offline-run-*/*.wandb")
    assert b"surrogate" in log.read_bytes()
    assert read_curves(tmp_path)["Loss/surrogate"][0] == [0, 1]


def test_wandb_is_needed_only_by_who_asks_for_it(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "wandb", None)
    make_runner(ToyEnv(), tmp_path).learn(1)
    with pytest.raises(RenetError, match="pip install wandb"):
        make_runner(ToyEnv(), tmp_path, logger="wandb").learn(1)
