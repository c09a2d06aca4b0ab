"""Curves of a training against a sum by hand."""

import json
from unittest.mock import Mock

import pytest

import recipe_curves
from recipe_curves import level_curves
from renet.curves import CURVES
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


def test_runs_too_short_to_draw_leave_the_file_as_it_is(tmp_path, monkeypatch):
    out = tmp_path / "recipe"
    out.with_suffix(".csv").write_text("kept\n")
    monkeypatch.setattr(recipe_curves, "OUT", out)
    (tmp_path / "config.json").write_text(
        '{"agent": {"num_steps_per_env": 5, "batch_size": 5, "seed": 1},'
        ' "env": {"scene": {"num_envs": 1}}}'
    )
    (tmp_path / CURVES).write_text("iteration,name,value\n0,Perf/total_fps,1000\n")
    with pytest.raises(SystemExit, match="nothing to draw"):
        recipe_curves.main([str(tmp_path)])
    assert out.with_suffix(".csv").read_text() == "kept\n"
