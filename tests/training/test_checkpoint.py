"""Checkpoints make room for newer ones and leave everything else alone."""

from pathlib import Path

import pytest
import torch

from renet.errors import RenetError
from renet.training import checkpoint
from renet.training.checkpoint import Checkpoint, checkpoints, save


def test_making_room_deletes_checkpoints_alone(tmp_path: Path):
    """Not folders that are named alike, hold somebody's notes as well, or lie behind a link."""
    for name in ("it_notes", "it_1", "it_000000010", "it_00000001.bak", "it_00000002"):
        (tmp_path / "run" / name).mkdir(parents=True)
        (tmp_path / "run" / name / "state.json").write_text("{}")
        (tmp_path / "run" / name / "thesis.tex").write_text("years of work")
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "state.json").write_text("{}")
    (tmp_path / "run" / "it_00000003").symlink_to("../elsewhere")
    for iteration in (4, 5, 6):
        save(Checkpoint({}, {}, {}), tmp_path / "run", iteration, keep=1)
    assert [path.name for path in checkpoints(tmp_path / "run")] == ["it_00000002", "it_00000006"]
    assert len(list(tmp_path.rglob("thesis.tex"))) == 5
    assert (tmp_path / "elsewhere" / "state.json").exists()


def test_what_a_kill_left_of_an_old_checkpoint_goes_with_the_next(tmp_path: Path):
    """The state goes first; somebody's notes stay."""
    for name, entry in (("it_00000001", ""), ("it_00000002", "model.safetensors")):
        (tmp_path / name).mkdir()
        if entry:
            (tmp_path / name / entry).write_bytes(b"")
    (tmp_path / "it_00000003").mkdir()
    (tmp_path / "it_00000003" / "notes.txt").write_text("mine")
    save(Checkpoint({}, {}, {}), tmp_path, 9, keep=1)
    assert {path.name for path in tmp_path.iterdir()} == {"it_00000003", "it_00000009"}


def test_what_a_kill_left_of_a_new_checkpoint_goes_with_the_next(tmp_path: Path):
    """Not folders that are named alike, hold somebody's notes as well, or lie behind a link."""
    partial = ".it_00000007.0123456789abcdef.partial"
    others = (".it_7.partial", ".notes.0123456789abcdef.partial", partial.replace("0123", "3210"))
    for name in (partial, *others):
        (tmp_path / name).mkdir()
        (tmp_path / name / "state.json").write_text("{}")
    (tmp_path / others[-1] / "notes.txt").write_text("mine")
    (tmp_path / partial.replace("007", "008")).symlink_to(others[0])
    save(Checkpoint({}, {}, {}), tmp_path, 9, keep=1)
    left = {*others, partial.replace("007", "008"), "it_00000009"}
    assert {path.name for path in tmp_path.iterdir()} == left


@pytest.mark.parametrize("name", ["model", "average"])
def test_weights_of_other_sizes_are_refused(tmp_path: Path, name: str, monkeypatch):
    """Before any of them takes memory."""
    small, large = ({"weight": torch.zeros(n, 2)} for n in (3, 5))
    weights = {"model": small, "average": small} | {name: large}
    state = {"steps": 1, "seconds": 1.0, "task": "x", "agent": {}, "env": {}}
    path = save(Checkpoint(optimizer={}, environment={}, state=state, **weights), tmp_path, 1, 1)
    loaded = []
    monkeypatch.setattr(checkpoint, "load_file", lambda file, device: loaded.append(file.stem))
    monkeypatch.setattr(checkpoint, "load_state", lambda path: state)
    network = torch.nn.Linear(2, 3, bias=False)
    with pytest.raises(RenetError):
        checkpoint.load_checkpoint(path, "cpu", network)
    assert name not in loaded
