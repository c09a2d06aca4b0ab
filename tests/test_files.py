"""Files handed in by strangers: one clear error each, without waiting or eating memory."""

import json
import os
from functools import partial
from pathlib import Path
from unittest.mock import Mock

import pytest
from hypothesis import given
from hypothesis import strategies as st

from renet import files
from renet.errors import RenetError


def test_what_is_not_a_regular_file_is_refused_without_waiting(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", Path("/dev/zero"), tmp_path):
        for read in (partial(files.read_bytes, limit=10), files.read_object):
            with pytest.raises(RenetError, match=r"log .*(not a regular file|Is a directory)"):
                read(path, what="log")
        with pytest.raises(RenetError, match=r"the log .* is not a regular file"):
            files.require_regular(path, 10, "log")
    for path in (tmp_path / "none", Path("a\0b")):
        for check in (files.read_bytes, files.require_regular):
            with pytest.raises(RenetError, match="cannot read the log"):
                check(path, 10, "log")


def test_size_limits_hold_to_the_byte_and_for_sparse_files(tmp_path):
    path = tmp_path / "file"
    path.write_bytes(b"x" * 10)
    assert files.read_bytes(path, 10) == b"x" * 10
    assert files.require_regular(path, 10) == path
    for check in (files.read_bytes, files.require_regular):
        with pytest.raises(RenetError, match="at most"):
            check(path, 9)
    os.truncate(path, 1 << 40)
    with pytest.raises(RenetError, match="at most"):
        files.read_bytes(path, 1000)


@pytest.mark.parametrize("bad", ["", "{", "[1,]", "\xff", "9" * 5000, "[1]"])
def test_what_is_not_a_json_object_is_named(tmp_path, bad):
    path = tmp_path / "x.json"
    path.write_text(bad, encoding="latin-1")
    problem = "must hold a JSON object, not list" if bad == "[1]" else "is not JSON"
    with pytest.raises(RenetError, match=f"summary {path} {problem}"):
        files.read_object(path, "summary")


@pytest.mark.parametrize("depth", [files.MAX_DEPTH + 1, 1_000, 1_000_000])
def test_deep_nesting_is_refused(depth):
    for text in ("[" * depth + "]" * depth, '{"a":' * depth + "1" + "}" * depth):
        with pytest.raises(RenetError, match="nested deeper"):
            files.parse_json(text, "manifest")


@given(st.recursive(st.none() | st.booleans() | st.integers() | st.text(), st.lists, max_leaves=20))
def test_json_within_the_limits_is_read_unchanged(value):
    assert files.parse_json(json.dumps(value), "value") == value


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_a_write_that_ends_early_leaves_what_was_there(tmp_path, monkeypatch, error):
    path = tmp_path / "manifest.json"
    files.write_atomically(path, b"old")
    monkeypatch.setattr(os, "fsync", Mock(side_effect=error))
    with pytest.raises((RenetError, KeyboardInterrupt), match=r"No space left|^$"):
        files.write_atomically(path, b"new")
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_no_write_follows_a_link_or_replaces_what_it_did_not_create(tmp_path):
    victim, link = tmp_path / "victim", tmp_path / "link"
    victim.write_bytes(b"mine")
    for target in (victim, tmp_path / "not yet"):
        link.symlink_to(target)
        with pytest.raises(RenetError, match="cannot write the log"):
            files.create(link, "log")
        with pytest.raises(OSError, match="symbolic link"):
            files.append(link)
        files.write_atomically(link, b"new")
        assert link.read_bytes() == b"new"
        assert not link.is_symlink()
        files.remove(link)
    with pytest.raises(RenetError, match="File exists"):
        files.create(victim)
    assert victim.read_bytes() == b"mine"
    assert list(tmp_path.iterdir()) == [victim]


def test_a_pipe_where_a_file_goes_never_makes_a_write_wait(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with pytest.raises(OSError, match=r"not a regular file|No such device"):
        files.append(pipe)
    with pytest.raises(RenetError, match="File exists"):
        files.create(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    with pytest.raises(OSError, match="not a regular file"):
        files.append(pipe)
    os.close(reader)
    files.write_atomically(pipe, b"new")
    assert pipe.read_bytes() == b"new"


def test_appended_lines_follow_what_was_there(tmp_path):
    files.sync(tmp_path / "nowhere")  # What cannot be flushed is written all the same.
    for line in ("one\n", "two\n"):
        with files.append(tmp_path / "log") as file:
            file.write(line)
            assert (tmp_path / "log").read_text().endswith(line), "a line at a time"
    assert (tmp_path / "log").read_text() == "one\ntwo\n"


def test_names_of_temporaries_are_never_the_same_and_recognised():
    path = Path("/folder/manifest.json")
    names = {files.temporary_path(path) for _ in range(100)}
    assert len(names) == 100
    assert all(name.parent == path.parent and files.is_temporary(name.name) for name in names)
    for name in ("manifest.json", ".manifest.json.partial", ".x.0123456789abcde.partial"):
        assert not files.is_temporary(name)


@pytest.mark.parametrize("path", [Path(), Path("a\0b"), Path("x" * 256), Path("/dev/null/x")])
def test_a_path_that_cannot_be_written_is_one_error(path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for write in (lambda: files.write_atomically(path, b""), lambda: files.create(path)):
        with pytest.raises(RenetError, match="cannot write the file"):
            write()
