"""Curves on disk."""

import json

import pytest

from renet.errors import RenetError
from renet.training.metrics import CURVES, MetricsWriter, level_curves, read_curves


def test_a_resumed_runs_last_value_counts(tmp_path):
    for value in (1.0, 2.0):
        writer = MetricsWriter(str(tmp_path))
        writer.add_scalar("Loss/value", value, 7)
        writer.stop()
    assert read_curves(tmp_path) == {"Loss/value": ([7], [2.0])}


def test_a_full_disk_and_a_file_that_cannot_be_opened_are_named(tmp_path):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / CURVES).symlink_to("/dev/full")
    with pytest.raises(RenetError, match=r"cannot write the curves .*No space left"):
        MetricsWriter(str(tmp_path / "full"))
    (tmp_path / CURVES).mkdir()
    with pytest.raises(RenetError, match="cannot write the curves"):
        MetricsWriter(str(tmp_path))


def test_a_row_torn_by_a_power_cut_costs_itself_alone(tmp_path):
    writer = MetricsWriter(str(tmp_path))
    writer.add_scalar("Loss/value", 1.0, 1)
    writer.stop()
    with (tmp_path / CURVES).open("a") as file:
        file.write("2,Loss/val")
    writer = MetricsWriter(str(tmp_path))
    writer.add_scalar("Loss/value", 3.0, 3)
    writer.stop()
    assert read_curves(tmp_path) == {"Loss/value": ([1, 3], [1.0, 3.0])}


def test_levels_over_steps_follow_the_batches_schedule(tmp_path):
    config = {"num_envs": 100, "num_steps_per_env": None, "batch_size": "2500@5000,5000@10000"}
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
