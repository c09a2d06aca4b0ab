"""Checkpoints make room for newer ones and leave everything else alone."""

from pathlib import Path

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
