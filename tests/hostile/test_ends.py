"""Whatever ends a command while it writes, its results are as they were or as they are to be.

An audit hook sees each step by which a command creates, renames or deletes a file. A KILL leaves
what is there before such a step; a full disk and Ctrl-C end it there.
"""

import os
import resource
import shutil
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import torch

from renet.bundle import DEFAULT, Bundle, pretrained, read_manifest, write_manifest
from renet.cli import main
from renet.deploy.recording.reader import read_recording
from renet.errors import RenetError
from renet.files import is_temporary
from renet.page.writer import VENDOR
from renet.training import checkpoint as checkpoints
from renet.training import export
from renet.training.checkpoint import Checkpoint

from .files import ticks

WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT
FULL = OSError(28, "No space left on device")

DELETING = ("os.remove", "os.rmdir")
"""Steps of the last kind, which take room from no disk; Ctrl-C in them may leave a temporary."""

on_step: Callable[[], None] | None = None
"""What is called before each step, while a test watches one."""
deletions = True
"""Whether it is called before those that delete."""


def hook(event: str, arguments: tuple) -> None:
    """Audit hooks are never removed: this one does nothing between tests."""
    global on_step
    if on_step is None:
        return
    path, step = str(arguments[0]) if arguments else "", on_step
    created = event == "open" and isinstance(arguments[2], int) and arguments[2] & WRITING
    changed = created or event in ("os.mkdir", "os.rename", *(DELETING if deletions else ()))
    exchanged = event == "ctypes.dlopen" and arguments[0] is None
    if exchanged or (changed and "/pytest-" in path):
        on_step = None  # Not of its own steps.
        step()
        if on_step is None and step is not None:
            on_step = step


sys.addaudithook(hook)


@pytest.fixture(autouse=True)
def no_steps() -> Iterator[None]:
    yield
    global on_step
    on_step = None


@dataclass
class Case:
    """A command that writes to `out`, in which there are results of before."""

    run: Callable[[], int | None]
    out: Path
    whole: bool = False
    """Its folder is exchanged whole; else each of its files is."""
    stride: int = 1
    """Every how many of its steps are ended by an error: a page has many files."""

    def units(self, root: Path) -> dict[str, object]:
        """What is replaced at once, by name; temporaries left out."""
        files = {
            path.relative_to(root).as_posix(): path.read_bytes()
            for path in sorted(root.rglob("*"))
            if path.is_file() and not any(map(is_temporary, path.relative_to(root).parts))
        }
        return {"": files} if self.whole else dict(files)


def cli(*arguments: object) -> Callable[[], int]:
    return lambda: main(list(map(str, arguments)))


def bundle_case(folder: Path) -> Case:
    shutil.copytree(pretrained(DEFAULT), folder / "out" / "bundle")
    weights = pretrained("checkpoint")
    return Case(cli("export", weights, "--out", folder / "out" / "bundle"), folder / "out", True)


def manifest_case(folder: Path) -> Case:
    path = Path(shutil.copytree(pretrained(DEFAULT), folder / "out"))
    manifest = read_manifest(path)
    selector = replace(manifest.selector, calibration="mine")
    return Case(lambda: write_manifest(path, replace(manifest, selector=selector)), path)


def page_case(folder: Path) -> Case:
    for name in VENDOR:
        (folder / "packages" / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / "packages" / name).write_text(name)
    (folder / "out").mkdir()
    arguments = ("page", "--out", folder / "out" / "page", "--runtime", folder / "packages")
    assert cli("page", pretrained(DEFAULT), *arguments[1:])() == 0
    other = Path(shutil.copytree(pretrained(DEFAULT), folder / "other"))
    return Case(cli("page", other, *arguments[1:]), folder / "out", True, 9)


def card_case(folder: Path) -> Case:
    (folder / "out").mkdir()
    (folder / "out" / "README.md").write_text("---\nan earlier card")
    return Case(cli("bundle", "card", "--out", folder / "out"), folder / "out")


def score_case(folder: Path) -> Case:
    (folder / "a.mcap").write_bytes(ticks())
    (folder / "out").mkdir()
    (folder / "out" / "score.json").write_text("an earlier score")
    return Case(cli("evaluate", "log", folder / "a.mcap", "--out", folder / "out"), folder / "out")


def checkpoint_case(folder: Path) -> Case:
    def save(iteration: int) -> Path:
        weights = {"a": torch.full((3,), float(iteration))}
        checkpoint = Checkpoint(weights, weights, weights, {"steps": iteration}, weights)
        return checkpoints.save(checkpoint, folder / "out", iteration, keep=9)

    save(1)
    return Case(lambda: save(1) and None, folder / "out", True)


CASES = {
    "export": bundle_case,
    "calibrate": manifest_case,
    "page": page_case,
    "card": card_case,
    "log": score_case,
    "checkpoint": checkpoint_case,
}


@pytest.fixture(scope="module")
def models() -> dict[str, bytes]:
    """What an export makes, which takes a while."""
    return export.export_models(export.load_networks(checkpoints.find(pretrained("checkpoint"))))


@pytest.fixture(params=CASES.values(), ids=CASES)
def case(request, tmp_path, monkeypatch, models) -> Case:
    monkeypatch.setattr(export, "export_models", lambda networks: models)
    return request.param(tmp_path)


def watch(case: Case, step: Callable[[], None], deleting: bool = True) -> int | None:
    """Run a command, and call `step` before each of its steps."""
    global on_step, deletions
    on_step, deletions = step, deleting
    try:
        return case.run()
    finally:
        on_step = None


def test_a_kill_at_any_step_leaves_old_results_or_new_ones(case, tmp_path):
    old, states = case.units(case.out), []
    assert not watch(case, lambda: states.append(case.units(case.out)))
    new = case.units(case.out)
    assert len(states) >= 3
    assert new
    for number, state in enumerate(states):
        for name, content in state.items():
            assert content in (old.get(name), new.get(name)), (number, name)
        assert set(old) <= set(state), "nothing that was there is missing"


@pytest.mark.parametrize("error", [FULL, KeyboardInterrupt()], ids=["full disk", "Ctrl-C"])
def test_an_end_at_any_step_is_one_line_and_leaves_nothing_beside(case, tmp_path, capsys, error):
    before = snapshot(case.out)
    for number in range(0, 1000, case.stride):
        count = 0

        def step(number: int = number) -> None:
            nonlocal count
            count += 1
            if count - 1 == number:
                raise error

        try:
            code = watch(case, step, deleting=False)
        except (RenetError, type(error)):  # Of a function, not a command.
            code = 2
        if count <= number:
            break
        said = capsys.readouterr().err
        assert "Traceback" not in said
        assert code in (0, None, 2, 130), said
        after = snapshot(case.out)
        assert not [name for name in after if any(map(is_temporary, Path(name).parts))], number
        assert set(before) <= set(after)
    assert number >= 3
    assert not code


def snapshot(folder: Path) -> dict[str, int]:
    return {str(path.relative_to(folder)): path.lstat().st_mode for path in folder.rglob("*")}


def test_a_disk_that_is_full_half_way_through_a_file_is_one_line(case, tmp_path, capsys):
    old = case.units(case.out)
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (50, limit[1]))
    try:
        code = case.run()
    except RenetError:
        code = 2
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
    said = capsys.readouterr()
    assert code == 2, said
    assert "Traceback" not in said.err
    assert case.units(case.out) == old
    assert not [name for name in snapshot(case.out) if any(map(is_temporary, Path(name).parts))]


@pytest.mark.parametrize("out", ["/proc/x", "/dev/null/x", "/dev/full"])
@pytest.mark.parametrize(
    "command",
    [
        ("export", str(pretrained("checkpoint"))),
        ("bundle", "card"),
        ("evaluate", "log", "a.mcap"),
        ("deploy", "--seconds", "0.1"),
        ("page", "--runtime", "packages"),
    ],
    ids=lambda command: " ".join(command[:2]),
)
def test_a_place_that_cannot_be_written_is_one_line(tmp_path, monkeypatch, capsys, command, out):
    monkeypatch.chdir(tmp_path)
    page_case(tmp_path)
    (tmp_path / "a.mcap").write_bytes(ticks())
    capsys.readouterr()
    assert main([*command, "--out", out]) == 2
    said = capsys.readouterr().err
    assert said.count("renet: ") == 1, said
    assert "Traceback" not in said


def test_a_kill_at_any_step_of_a_run_leaves_a_recording_up_to_there(tmp_path):
    out, sizes, unreadable = tmp_path / "out", [0], 0

    def step() -> None:
        nonlocal unreadable
        for path in out.rglob("recording.mcap"):
            try:
                sizes.append(len(read_recording(path).ticks))
            except RenetError:
                unreadable += 1
                assert path.stat().st_size < 1000, "its header is not yet written"

    run = Case(cli("deploy", "--seconds", "3", "--out", out), out)
    assert watch(run, step) == 0
    assert len(sizes) > 3
    earlier = read_recording(out / "recording.mcap")
    assert watch(run, step) == 0
    kept = read_recording(out / "earlier-1" / "recording.mcap")
    np.testing.assert_array_equal(kept.ticks["now"], earlier.ticks["now"])


def test_two_runs_cannot_share_a_folder(tmp_path, capsys):
    from renet.folders import lock

    with lock(tmp_path):
        assert main(["deploy", "--seconds", "0.1", "--out", str(tmp_path)]) == 2
    assert "another program writes to" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
    assert Bundle.load()
