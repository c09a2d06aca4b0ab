"""Curves of runs over their steps, against sums by hand."""

import csv
import json

import pytest
from PIL import Image

from renet import cli
from renet.errors import RenetError
from renet.evaluation import figures
from renet.evaluation.curves import CurvesCfg, make_curves

GAP, STEPS = "Curriculum/level/gap", "Curriculum/environment_steps"


def write_run(folder, levels, each=1000, name="curves.csv"):
    """A run whose iterations take `each` steps and have these levels."""
    folder.mkdir(exist_ok=True)
    lines = ["iteration,name,value"]
    for number, level in enumerate(levels):
        lines += [f"{number},{STEPS},{(number + 1) * each}", f"{number},{GAP},{level}"]
    (folder / name).write_text("\n".join(lines) + "\n")
    return folder


def made(tmp_path, *runs, **options):
    """The table that the runs make."""
    options = {"curves": (GAP,), "smooth": 1, "out": tmp_path / "out"} | options
    make_curves(CurvesCfg(tuple(map(str, runs)), **options))
    return json.loads((tmp_path / "out" / "summary.json").read_text())["runs"]


def test_seeds_are_compared_at_the_last_step_they_share(tmp_path):
    first = write_run(tmp_path / "a", [0, 1, 2, 3])
    second = write_run(tmp_path / "b", [0, 2, 4])
    (row,) = made(tmp_path, f"{first}=recipe", f"{second}=recipe")
    assert row["steps"] == 3000
    assert (row["seeds"], row["mean"], row["lowest"], row["highest"]) == (2, 3.0, 2.0, 4.0)
    assert row["sd"] == pytest.approx(2**0.5)
    with (tmp_path / "out" / "summary.csv").open() as file:
        assert next(csv.DictReader(file))["label"] == "recipe"
    assert Image.open(tmp_path / "out" / "curves.png").width > 300


def test_runs_without_a_common_step_are_no_seeds_of_one_recipe(tmp_path):
    first = write_run(tmp_path / "first", [0, 1, 2])
    later = write_run(tmp_path / "later", [0, 1, 2], each=10_000)
    with pytest.raises(RenetError, match="runs of recipe have no environment steps in common"):
        made(tmp_path, f"{first}=recipe", f"{later}=recipe")
    assert not (tmp_path / "out").exists()
    assert len(made(tmp_path, first, later)) == 2


def test_runs_are_not_read_before_they_begin(tmp_path):
    run = write_run(tmp_path / "run", [4, 1, 2])
    assert made(tmp_path, run, until=1000)[0]["mean"] == 4.0
    with pytest.raises(RenetError, match="--until 999 is before the runs of run begin, at 1000"):
        made(tmp_path, run, until=999)


def test_a_default_curve_that_a_task_lacks_is_left_out(tmp_path):
    """A task on a plane has no levels; a curve that is asked for must be there."""
    flat = tmp_path / "flat"
    flat.mkdir()
    rows = ["iteration,name,value", f"0,{STEPS},1000", "0,Train/mean_reward,7"]
    (flat / "curves.csv").write_text("\n".join(rows) + "\n")
    (row,) = made(tmp_path, flat, curves=CurvesCfg.curves)
    assert (row["curve"], row["mean"]) == ("Train/mean_reward", 7.0)
    with pytest.raises(RenetError, match="unknown curve 'Curriculum/level/'"):
        made(tmp_path, flat, curves=("Curriculum/level/", "Train/mean_reward"))


def test_zeros_that_a_power_failure_left_are_skipped(tmp_path):
    run = write_run(tmp_path / "run", [0, 1])
    with (run / "curves.csv").open("ab") as file:
        # More than the longest field that Python's csv reads.
        file.write(f"2,{GAP}".encode() + bytes(200_000) + f"\n1,{GAP},3\n".encode())
    assert made(tmp_path, run)[0]["mean"] == 3.0


def test_a_file_that_is_no_table_is_refused(tmp_path):
    run = write_run(tmp_path / "run", [0, 1])
    with (run / "curves.csv").open("a") as file:
        file.write("x" * 200_000)
    with pytest.raises(RenetError, match=r"cannot read the curves .*field larger than"):
        made(tmp_path, run)


@pytest.fixture
def legends(monkeypatch) -> list[list[str]]:
    """Labels in the legend of each figure that is drawn."""
    drawn = []
    render = figures.png

    def keep(figure, *arguments):
        (legend,) = figure.legends
        drawn.append([text.get_text() for text in legend.get_texts()])
        return render(figure, *arguments)

    monkeypatch.setattr(figures, "png", keep)
    return drawn


def test_the_legend_names_runs_that_only_a_later_panel_shows(tmp_path, legends):
    tiles = write_run(tmp_path / "tiles", [0, 1])
    flat = write_run(tmp_path / "flat", [])
    for run in (tiles, flat):
        with (run / "curves.csv").open("a") as file:
            file.write(f"0,{STEPS},1000\n0,Train/mean_reward,7\n")
    made(tmp_path, tiles, flat, curves=(GAP, "Train/mean_reward"))
    assert legends == [["tiles", "flat"]]


def test_runs_with_batches_of_their_own_are_compared_by_steps(tmp_path):
    small = write_run(tmp_path / "small", [0, 1, 2, 3, 4], each=1000)
    large = write_run(tmp_path / "large", [1, 3], each=2500)
    rows = made(tmp_path, small, large, until=3500)
    # Between the third and the fourth iteration, and between the first and the second.
    assert [(row["label"], row["mean"]) for row in rows] == [("small", 2.5), ("large", 1.8)]
    assert [row["sd"] for row in rows] == [None, None]


def test_a_run_is_named_after_its_folder_also_with_a_dot_in_it(tmp_path):
    high = write_run(tmp_path / "rate0.5", [0, 1])
    low = write_run(tmp_path / "rate0.3", [0, 3])
    rows = made(tmp_path, high, low)
    assert [(row["label"], row["seeds"]) for row in rows] == [("rate0.5", 1), ("rate0.3", 1)]
    kept = write_run(tmp_path / "kept", [0, 1], name="rate0.5.csv")
    assert made(tmp_path, kept / "rate0.5.csv")[0]["label"] == "rate0.5"


def test_points_are_means_of_iterations(tmp_path):
    run = write_run(tmp_path / "run", [0, 0, 3, 6])
    (row,) = made(tmp_path, run, smooth=3)
    assert row["mean"] == 3.0
    assert row["steps"] == 3000


def test_a_torn_row_and_a_resumed_iteration(tmp_path):
    run = write_run(tmp_path / "run", [0, 1])
    with (run / "curves.csv").open("a") as file:
        file.write(f"1,{GAP},2\n\n1,{STEPS},2000\n2,{GAP}")
    assert made(tmp_path, run / "curves.csv")[0]["mean"] == 2.0


@pytest.mark.parametrize(
    ("prepare", "options", "message"),
    [
        (lambda path: path.mkdir(), {}, "cannot read the curves .*No such file"),
        (lambda path: write_run(path, [1]), {"smooth": 10}, "has 1 iterations, fewer than"),
        (lambda path: write_run(path, [1]), {"curves": ("Curriculum/gap",)}, "unknown curve"),
        (lambda path: write_run(path, []), {}, "has no curve Curriculum/environment_steps"),
    ],
)
def test_runs_that_cannot_be_drawn_are_refused_and_nothing_is_written(
    tmp_path, prepare, options, message
):
    prepare(tmp_path / "run")
    with pytest.raises(RenetError, match=message):
        made(tmp_path, tmp_path / "run", **options)
    assert not (tmp_path / "out" / "summary.json").exists()


def test_the_command_prints_the_table(tmp_path, capsys):
    run = write_run(tmp_path / "run", range(12))
    options = ["--curves", GAP, "--out", str(tmp_path / "out")]
    assert cli.main(["evaluate", "curves", f"{run}=ours", *options]) == 0
    assert "ours" in capsys.readouterr().out
