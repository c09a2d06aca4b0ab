"""Curves on disk."""

import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from renet.curves import CURVES, read_curves
from renet.errors import RenetError
from renet.training.metrics import CurvesWriter, write_run_report

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


def test_missing_wandb_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "wandb", None)
    make_runner(ToyEnv(), tmp_path).learn(1)
    with pytest.raises(RenetError, match="pip install wandb"):
        make_runner(ToyEnv(), tmp_path, logger="wandb").learn(1)
