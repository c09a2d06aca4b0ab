"""Curves of a training against a sum by hand."""

import csv
import json
from collections.abc import Sequence
from pathlib import Path
from unittest.mock import Mock

import pytest

import recipe_curves
from recipe_curves import level_curves
from renet.curves import CURVES
from renet.errors import RenetError
from renet.terrain.tiles import tiles

OTHERS = ((1, 1_000_000), (2, 2_000_000), (2, 3_000_000))
"""Seeds and environment steps of another recipe's rows."""


def test_levels_over_steps_follow_the_batches_schedule(tmp_path):
    agent = {"num_steps_per_env": None, "batch_size": "2500@5000,5000@10000"}
    config = {"agent": agent, "env": {"scene": {"num_envs": 100}}}
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


def test_each_label_is_in_the_legend_with_its_length(tmp_path, monkeypatch):
    """The runs that are kept, and two of another label and length."""
    out = tmp_path / "recipe"
    columns = ["run", "seed", "steps", "hours", *tiles()]
    rows = [["other", seed, steps, 1.0, *[0.5] * len(tiles())] for seed, steps in OTHERS]
    lines = [columns, *rows]
    out.with_suffix(".csv").write_text("\n".join(",".join(map(str, line)) for line in lines))
    monkeypatch.setattr(recipe_curves, "OUT", out)
    drawn = Mock(return_value=b"")
    monkeypatch.setattr(recipe_curves.figures, "png", drawn)
    recipe_curves.main([])
    (figure,) = drawn.call_args.args
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.texts] == [
        f"{recipe_curves.SHIPPED} (232 M steps)",
        f"{recipe_curves.SIBLINGS} (30 M steps)",
        "other (3 M steps)",
    ]
    colours = [line.get_color() for line in legend.get_lines()]
    assert len(set(colours)) == 3
    # Runs of one label have one colour: one, two and two runs.
    assert [line.get_color() for line in figure.axes[0].lines] == [
        colours[label] for label in (0, 1, 1, 2, 2)
    ]


@pytest.fixture
def out(tmp_path, monkeypatch):
    """Path of the figure and the table, without their endings; the table holds earlier runs."""
    path = tmp_path / "recipe"
    path.with_suffix(".csv").write_text("kept\n")
    monkeypatch.setattr(recipe_curves, "OUT", path)
    return path


def write_run(folder: Path, kinds: Sequence[str], iterations: int = 10, first: float = 300.0):
    """Write a run of 100 robots, of 500 environment steps an iteration, and of seed 7.

    Args:
        folder: its folder, which is made.
        kinds: kinds of tile whose level is the number of the iteration.
        iterations: number of iterations.
        first: value of the curve of environment steps in the first of them.
    """
    folder.mkdir()
    agent = {"num_steps_per_env": 5, "batch_size": 500, "seed": 7}
    config = {"agent": agent, "env": {"scene": {"num_envs": 100}}}
    (folder / "config.json").write_text(json.dumps(config))
    lines = ["iteration,name,value"]
    for number in range(iterations):
        lines.append(f"{number},Perf/total_fps,1000")
        lines.append(f"{number},Curriculum/environment_steps,{first + 500 * number}")
        lines += [f"{number},Curriculum/level/{kind},{number}" for kind in kinds]
    (folder / CURVES).write_text("\n".join(lines) + "\n")
    return str(folder)


def written(out: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(out.with_suffix(".csv").read_text().splitlines()))


def test_a_kind_of_tile_of_ones_own_is_left_out_whichever_run_has_it(tmp_path, out):
    usual = write_run(tmp_path / "usual", list(tiles()))
    scene = write_run(tmp_path / "scene", ["own", *tiles()])
    recipe_curves.main([f"{usual}=usual", f"{scene}=scene"])
    rows = written(out)
    assert [row["run"] for row in rows] == ["usual", "scene"]
    assert {*rows[0]} == {"run", "seed", "steps", "hours", *tiles()}
    assert [row["gap"] for row in rows] == ["4.5", "4.5"]
    assert out.with_suffix(".png").exists()


def test_a_run_that_goes_on_from_another_begins_at_its_steps(tmp_path, out):
    begun = write_run(tmp_path / "begun", list(tiles()))
    branch = write_run(tmp_path / "branch", list(tiles()), first=2_000_300.0)
    recipe_curves.main([f"{begun}=begun", f"{branch}=branch"])
    assert [float(row["steps"]) for row in written(out)] == pytest.approx(
        [5000, 2_005_000], abs=500
    )


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["short"], "nothing to draw"),
        (["flat"], "no levels of"),
        (["one=mine", "two=mine"], "two runs are named mine, with seed 7"),
        (["nowhere"], "cannot read"),
    ],
)
def test_runs_that_cannot_be_drawn_leave_the_file_as_it_is(names, message, tmp_path, out):
    write_run(tmp_path / "short", list(tiles()), iterations=9)
    write_run(tmp_path / "flat", [])
    write_run(tmp_path / "one", list(tiles()))
    write_run(tmp_path / "two", list(tiles()))
    with pytest.raises(RenetError, match=message):
        recipe_curves.main([str(tmp_path / name) for name in names])
    assert out.with_suffix(".csv").read_text() == "kept\n"
    assert not out.with_suffix(".png").exists()
