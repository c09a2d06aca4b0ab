"""Folders are exchanged whole, and nothing that renet did not write is touched."""

import errno
import os
import signal
import subprocess
import sys
from pathlib import Path
from unittest.mock import Mock

import pytest

from renet import folders
from renet.errors import RenetError
from renet.files import temporary_path
from renet.folders import demand_own, foreign, lock, move, remove_folder, write_folder

OWN = ("a.txt", "sub/b.txt")
CONTENTS = {"a.txt": b"new", "sub/b.txt": b"new"}


def contents(folder: Path) -> dict[str, bytes | None]:
    """Everything below a folder: bytes of files, None for anything else."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes() if path.is_file() else None
        for path in folder.rglob("*")
    }


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    path = tmp_path / "out"
    write_folder(path, {"a.txt": b"old", "sub/b.txt": b"old"}, OWN, "page")
    return path


FOREIGN = {
    "a file": lambda path: (path / "thesis.tex").write_text("years"),
    "a file in a folder": lambda path: (path / "sub" / "thesis.tex").write_text("years"),
    "a folder": lambda path: (path / "photos").mkdir(),
    "a link to a file": lambda path: (path / "link").symlink_to("a.txt"),
    "a link in place of a file": lambda path: relink(path / "a.txt", "sub/b.txt"),
    "a link in place of a folder": lambda path: relink(path / "sub", path.parent),
    "a pipe": lambda path: os.mkfifo(path / "pipe"),
    "a folder in place of a file": lambda path: relink(path / "a.txt", None),
    "what looks like a temporary": lambda path: (path / ".a.txt.partial").write_text("years"),
}


def relink(path: Path, target: str | Path | None) -> None:
    path.rename(path.parent.parent / "moved")
    path.symlink_to(target) if target is not None else path.mkdir()


@pytest.mark.parametrize("add", FOREIGN.values(), ids=FOREIGN)
def test_a_folder_with_anything_foreign_is_left_as_it_is(folder, tmp_path, add):
    add(folder)
    before = contents(tmp_path)
    assert foreign(folder, OWN) is not None
    for refused in (
        lambda: write_folder(folder, CONTENTS, OWN, "page"),
        lambda: remove_folder(folder, OWN),
        lambda: demand_own(folder, OWN, "page"),
    ):
        with pytest.raises(RenetError, match="which is no part of a"):
            refused()
    assert contents(tmp_path) == before


def test_folders_that_cannot_be_its_own_are_not_entered(tmp_path):
    deep = tmp_path
    for _ in range(300):
        (deep := deep / "somebody's").mkdir()
    deep.parent.chmod(0)
    try:
        assert foreign(tmp_path, OWN) == "somebody's"
    finally:
        deep.parent.chmod(0o700)
    assert foreign(Path("/proc"), OWN) == "1"


def test_what_is_no_folder_is_left_as_it_is(tmp_path):
    (tmp_path / "file").write_text("years")
    (tmp_path / "link").symlink_to("nowhere")
    for name in ("file", "link"):
        with pytest.raises(RenetError, match="exists and is not a page"):
            demand_own(tmp_path / name, OWN, "page")
    with pytest.raises(RenetError, match="exists and is not a page"):
        write_folder(tmp_path / "file", CONTENTS, OWN, "page")
    assert (tmp_path / "file").read_text() == "years"


@pytest.mark.parametrize("unsupported", [None, *folders.UNSUPPORTED])
def test_a_folder_is_replaced_whole_and_nothing_stays_beside_it(
    folder, tmp_path, monkeypatch, unsupported
):
    if unsupported is not None:
        monkeypatch.setattr(folders, "_rename", Mock(side_effect=OSError(unsupported, "")))
    temporary_path(folder / "a.txt").write_text("of a killed program")
    write_folder(folder, {"a.txt": b"new"}, OWN, "page")
    assert contents(tmp_path) == {"out": None, "out/a.txt": b"new"}
    remove_folder(folder, OWN)
    remove_folder(folder, OWN)
    assert contents(tmp_path) == {}


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_a_write_that_fails_leaves_the_old_folder_and_nothing_beside_it(
    folder, tmp_path, monkeypatch, error
):
    def fail(path: Path, data: bytes) -> None:
        path.touch()
        raise error

    before = contents(tmp_path)
    monkeypatch.setattr(folders, "write_new", fail)
    with pytest.raises((RenetError, KeyboardInterrupt)):
        write_folder(folder, CONTENTS, OWN, "page")
    assert contents(tmp_path) == before


def test_a_file_added_while_a_folder_is_replaced_is_kept(folder, tmp_path, monkeypatch):
    real = folders._exchange

    def exchange(new: Path, final: Path) -> None:
        (final / "thesis.tex").write_text("years")
        real(new, final)

    monkeypatch.setattr(folders, "_exchange", exchange)
    with pytest.raises(RenetError, match=r"thesis\.tex"):
        write_folder(folder, CONTENTS, OWN, "page")
    assert [path.read_text() for path in tmp_path.rglob("thesis.tex")] == ["years"]
    assert (folder / "a.txt").read_bytes() == b"new"


KILLED = """
import os, sys
from pathlib import Path
from renet import folders
step, unsupported = int(sys.argv[2]), sys.argv[3] == "old"
count = 0

def trace(name):
    real = getattr(folders, name)
    def stop(*arguments):
        global count
        if count == step:
            os.kill(os.getpid(), 9)
        count += 1
        if name == "_rename" and unsupported:
            raise OSError(22, "")
        return real(*arguments)
    setattr(folders, name, stop)

for name in ("write_new", "sync", "_rename", "move", "remove_folder"):
    trace(name)
new = {"a.txt": b"new", "sub/b.txt": b"new"}
folders.write_folder(Path(sys.argv[1]), new, new, "page")
"""


@pytest.mark.parametrize("kernel", ["new", "old"])
@pytest.mark.parametrize("step", range(8))
def test_a_kill_at_any_step_leaves_the_old_folder_or_the_new_one(folder, step, kernel):
    """On a file system without an exchange the old one may be there under another name."""
    command = [sys.executable, "-c", KILLED, str(folder), str(step), kernel]
    code = subprocess.run(command).returncode
    assert code == -signal.SIGKILL or (code, kernel) == (0, "new")
    places = [folder] if folder.exists() else list(folder.parent.glob("out.earlier-*"))
    (whole,) = [contents(place) for place in places]
    assert whole["a.txt"] == whole["sub/b.txt"]
    assert whole["a.txt"] in (b"old", b"new")
    if kernel == "new":
        assert places == [folder]
        write_folder(folder, CONTENTS, OWN, "page")
        assert contents(folder) == {**CONTENTS, "sub": None}


def test_move_replaces_nothing(tmp_path, monkeypatch):
    (tmp_path / "a").write_text("a")
    (tmp_path / "b").write_text("b")
    with pytest.raises(OSError, match="File exists"):
        move(tmp_path / "a", tmp_path / "a")
    with monkeypatch.context() as patch:
        patch.setattr(folders, "_rename", Mock(side_effect=OSError(errno.EINVAL, "still there")))
        with pytest.raises(OSError, match="still there"):
            move(tmp_path / "a", tmp_path / "b")
    move(tmp_path / "a", tmp_path / "c")
    assert contents(tmp_path) == {"b": b"b", "c": b"a"}


def test_an_old_c_library_moves_and_exchanges_as_well(folder, tmp_path, monkeypatch):
    monkeypatch.setattr(folders.ctypes, "CDLL", lambda *_, **__: object())
    move(folder, tmp_path / "moved")
    files = {"a.txt": b"new", "sub/b.txt": b"new", "deep/er/c.txt": b"new"}
    write_folder(tmp_path / "moved", files, OWN, "page")
    assert contents(tmp_path / "moved") == {**files, "sub": None, "deep": None, "deep/er": None}


def test_a_locked_folder_is_anothers_until_that_ends(tmp_path):
    code = "import sys; from pathlib import Path; from renet.folders import lock\n"
    code += "with lock(Path(sys.argv[1])): print(flush=True); sys.stdin.read()"
    command = [sys.executable, "-c", code, str(tmp_path / "run")]
    other = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    other.stdout.readline()
    with pytest.raises(RenetError, match="another program writes to"), lock(tmp_path / "run"):
        pass
    other.kill()
    other.communicate()
    with lock(tmp_path / "run"):
        assert list((tmp_path / "run").iterdir()) == []
    (tmp_path / "file").touch()
    with pytest.raises(RenetError, match="cannot write to"), lock(tmp_path / "file"):
        pass
