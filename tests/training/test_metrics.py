"""Curves on disk."""

import os
import sys
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

from renet.curves import CURVES, LEVEL, STEPS, read_curves
from renet.errors import RenetError
from renet.training.metrics import PANELS, CurvesWriter, write_run_report

from .conftest import ToyEnv, make_runner


def write(folder: Path, value: float, iteration: int) -> None:
    writer = CurvesWriter(str(folder), "tensorboard", "")
    writer.add_scalar("Loss/value", value, iteration)
    writer.stop()


def test_unwritable_curves_are_named(tmp_path, monkeypatch):
    (tmp_path / CURVES).mkdir()
    with pytest.raises(RenetError, match="cannot write the curves"):
        CurvesWriter(str(tmp_path), "tensorboard", "")
    full = open("/dev/full", "a", buffering=1)  # noqa: SIM115  It closes it.
    monkeypatch.setattr("renet.training.metrics.append", lambda _: full)
    with pytest.raises(RenetError, match=r"cannot write the curves .*No space left"):
        CurvesWriter(str(tmp_path), "tensorboard", "")


def test_iterations_that_a_kill_lost_leave_the_curves(tmp_path):
    for iteration, value in [(1, 1.0), (2, 2.0), (3, 3.0), (4, 4.0), (2, 5.0)]:
        write(tmp_path, value, iteration)
    assert read_curves(tmp_path / CURVES) == {"Loss/value": {1: 1.0, 2: 5.0}}
    # Newer code may begin with a curve that the run did not have before.
    with (tmp_path / CURVES).open("a") as file:
        file.write("3,Loss/value,1\n4,Loss/value,1\n2,Loss/new,6\n2,Loss/value,6\n3,Loss/value,6\n")
    assert read_curves(tmp_path / CURVES) == {
        "Loss/value": {1: 1.0, 2: 6.0, 3: 6.0},
        "Loss/new": {2: 6.0},
    }


def test_resumed_curves_replace_torn_rows(tmp_path):
    write(tmp_path, 1.0, 1)
    write(tmp_path, 2.0, 1)
    with (tmp_path / CURVES).open("a") as file:
        file.write("2,Loss/val")
    write(tmp_path, 3.0, 3)
    assert read_curves(tmp_path / CURVES) == {"Loss/value": {1: 2.0, 3: 3.0}}


def ink(folder: Path) -> int:
    """Number of pixels with the colour of a figure's first line."""
    picture = np.asarray(Image.open(write_run_report(folder)).convert("RGB"), int)
    return int((np.abs(picture - (31, 119, 180)).max(axis=-1) < 40).sum())


def test_the_only_iteration_of_a_run_can_be_seen(tmp_path):
    write(tmp_path, 0.5, 0)
    assert ink(tmp_path) == 0, "it is in no panel"
    writer = CurvesWriter(str(tmp_path), "tensorboard", "")
    writer.add_scalar("Train/mean_reward", 3.0, 0)
    writer.stop()
    assert ink(tmp_path) > 8


def drawn_axes(folder: Path, monkeypatch) -> dict[str, Axes]:
    """Panels that the figure shows, by title."""
    with monkeypatch.context() as patch:
        saved = Mock()
        patch.setattr(Figure, "savefig", lambda figure, *args, **options: saved(figure))
        write_run_report(folder)
    ((figure,),) = [call.args for call in saved.call_args_list]
    return {axis.get_title(): axis for axis in figure.axes if axis.axison}


def test_curves_over_steps_without_empty_panels(tmp_path, monkeypatch):
    writer = CurvesWriter(str(tmp_path), "tensorboard", "")
    # Batches grow, and iterations end without a finished episode.
    for iteration, steps in ((0, 1e6), (1, 2e6), (3, 6e6)):
        writer.add_scalar(STEPS, steps, iteration)
    for iteration in range(4):
        writer.add_scalar("Train/mean_reward", 2.0, iteration)
        for kind in ("gap", "rough"):
            writer.add_scalar(f"{LEVEL}{kind}", 1.0, iteration)
    writer.stop()
    axes = drawn_axes(tmp_path, monkeypatch)
    assert list(axes) == ["reward per episode", "terrain level"]
    for axis in axes.values():
        assert axis.get_xlabel() == "million steps"
        for line in axis.lines:
            np.testing.assert_allclose(np.asarray(line.get_xdata()), [1.0, 2.0, 4.0, 6.0])
    assert [text.get_text() for text in axes["terrain level"].get_legend().texts] == [
        "gap",
        "rough",
    ]


@pytest.mark.parametrize("count", [5, 16])
def test_panels_fill_their_rows(tmp_path, monkeypatch, count):
    writer = CurvesWriter(str(tmp_path), "tensorboard", "")
    for _, pattern in PANELS[:count]:
        writer.add_scalar(f"{pattern}gap" if isinstance(pattern, str) else pattern[0], 1.0, 0)
    writer.stop()
    axes = drawn_axes(tmp_path, monkeypatch)
    assert len(axes) == count
    grid = next(iter(axes.values())).get_gridspec()
    assert (grid.nrows, grid.ncols) == {5: (2, 3), 16: (4, 4)}[count]
    assert {axis.get_xlabel() for axis in axes.values()} == {"iteration"}, "it counts no steps"


def test_curves_go_to_wandb(tmp_path, monkeypatch):
    """The run's own process would wait for the network; offline it writes a folder."""
    wandb = pytest.importorskip("wandb")
    for name, value in {"MODE": "offline", "DIR": str(tmp_path), "SILENT": "true"}.items():
        monkeypatch.setenv(f"WANDB_{name}", value)
    make_runner(ToyEnv(), tmp_path, logger="wandb").learn(2)
    wandb.teardown()  # Its service writes what is left.
    (log,) = (tmp_path / "wandb").glob("offline-run-*/*.wandb")
    assert b"surrogate" in log.read_bytes()
    assert [*read_curves(tmp_path / CURVES)["Loss/surrogate"]] == [0, 1]


def test_tags_go_to_wandb(tmp_path, monkeypatch):
    begun = []
    log = SimpleNamespace(log=lambda *_, **__: None, config={}, finish=lambda: None)
    fake = SimpleNamespace(run=None, init=lambda **_: begun.append(os.environ["WANDB_TAGS"]) or log)
    monkeypatch.setitem(sys.modules, "wandb", fake)
    monkeypatch.setenv("WANDB_TAGS", "")
    make_runner(ToyEnv(), tmp_path, logger="wandb", wandb_tags=("ours", "first")).learn(1)
    assert begun == ["first,ours"]


def test_missing_wandb_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "wandb", None)
    make_runner(ToyEnv(), tmp_path).learn(1)
    with pytest.raises(RenetError, match="pip install wandb"):
        make_runner(ToyEnv(), tmp_path, logger="wandb").learn(1)
