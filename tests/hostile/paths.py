"""Hands hostile files to every option of every command that takes a path."""

import dataclasses
import hashlib
import io
import json
import math
import os
import resource
import shutil
import signal
import typing
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

from renet import trial
from renet.bundle import DEFAULT, models, pretrained
from renet.cli import COMMANDS, main
from renet.deploy.robots.sim import scene_file
from renet.errors import RenetError
from renet.page.writer import VENDOR
from renet.terrain import own_ground

from ..forked import Fork
from .files import ticks

MEMORY = 500_000
"""Kilobytes that a file may cost beside what its command needs for a path that does not exist."""
PROCESSOR = 10.0
"""Seconds of processor time, trials included; 5.1 were seen beside other tests on slow cores."""
PATIENCE = 120
"""Seconds of a busy computer's clock."""
OUTPUTS = ("out", "log_root")
"""Options that name what is written."""
PATHS_AS_TEXT = ("resume", "runs")
"""Options that name what is read and are not typed as paths."""
VARIANTS: dict[str, list[list[str]]] = {
    "deploy": [["--seconds", "0.1"], ["--camera", "replay", "--seconds", "0.1"]],
    "page": [["--runtime", "packages"]],
    "train": [["Renet-Go1-Flat", "--max-iterations", "1", "--num-envs", "2"]],
    "bundle card": [["--out", "out"]],
    "bundle push": [["shipped", "owner/name"]],
    "calibrate": [["shipped"]],
    "identify": [["recording.mcap", "--robot", "go2"]],
    "evaluate leaderboard": [["recording.mcap"]],
    "evaluate log": [["recording.mcap", "--out", "out"]],
}
"""Options that a command, or one of its options, needs to go on to a path; none by default."""
ACCEPTED = {
    "recipe": {"history 1e9", "hidden abc", "of pipes", "tensors of", "a header of"},
    "evaluate log": {"a length of 4 GB"},
}
"""Parts of the names of files that a command does read: settings as they stand, without weights;
and a recording that is torn at its first chunk."""


def is_path(hint: object) -> bool:
    return hint is Path or any(map(is_path, typing.get_args(hint)))


def inputs(config: object) -> Iterator[str]:
    """Options of a configuration that name what is read; positional ones without dashes."""
    cls = config if isinstance(config, type) else type(config)
    hints = typing.get_type_hints(cls, include_extras=True)
    for field in dataclasses.fields(cls):  # type: ignore[arg-type]
        value = getattr(config, field.name, None)
        if dataclasses.is_dataclass(value):
            yield from inputs(value)
        elif field.name in PATHS_AS_TEXT or (
            is_path(hints[field.name]) and field.name not in OUTPUTS
        ):
            positional = "Positional" in str(hints[field.name])
            yield field.name if positional else f"--{field.name.replace('_', '-')}"


def options() -> Iterator[tuple[str, str, tuple[str, ...]]]:
    """Every command, each option of it that reads a path, and what else it needs."""
    for name, command in COMMANDS.items():
        presets = [["--preset", preset] for preset in command.presets]
        for variant in VARIANTS.get(name, [[]]) + presets:
            _, config, _ = command.load(variant)
            if hasattr(config, "defaults"):
                config = config.defaults(variant)
            for option in inputs(config):
                (chosen,) = VARIANTS.get(f"{name} {option}", [variant])
                yield name, option, tuple(chosen)


OPTIONS = list({triple[:2]: triple for triple in reversed([*options()])}.values())
"""Each with the first options that a command can have it with."""


def command_line(name: str, option: str, variant: tuple[str, ...], path: str) -> list[str]:
    """The command with a path for one of its options; a positional one replaces the variant's."""
    if option.startswith("--"):
        return [*name.split(), *variant, option, path]
    positional = variant and not variant[0].startswith("--") and name != "train"
    return [*name.split(), path, *variant[1 if positional else 0 :]]


def snapshot(folder: Path) -> dict[str, tuple]:
    """What a change of any file below a folder changes."""
    return {
        str(path): (s.st_mode, s.st_size, s.st_mtime_ns, s.st_ino)
        for path in [folder, *folder.rglob("*")]
        for s in [path.lstat()]
    }


def usage() -> tuple[float, int]:
    """Processor time in s and peak memory in kB of this process and its children."""
    both = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in both), max(u.ru_maxrss for u in both)


def attempt(arguments: list[str], most: float = math.inf, accepted: bool = False) -> str:
    """What is wrong with how a command took its arguments; empty if nothing is.

    Args:
        arguments: of the command line.
        most: kilobytes that this process, or one of its children, may take.
        accepted: the command may read what it was given, and need not refuse it.
    """
    out, error = io.StringIO(), io.StringIO()
    seconds, code = usage()[0], -1
    try:
        with redirect_stdout(out), redirect_stderr(error):
            code = main(arguments)
    except SystemExit as exit:
        return f"cannot be parsed ({exit.code}): {error.getvalue()[-300:]}"
    except BaseException as raised:
        return f"raised {type(raised).__name__}: {raised}"[:300]
    after, peak = usage()
    said = error.getvalue()
    lines = [line for line in said.splitlines() if line.startswith("renet:")]
    wrong = {
        f"exit code {code}: {said[-300:]}": code not in ((0, 2) if accepted else (2,)),
        f"a refusal in {len(lines)} lines: {said[-600:]}": code == 2 and len(lines) != 1,
        f"a long refusal: {said[:200]}": len(said) > 2500,
        "escape codes": "\x1b]" in said + out.getvalue(),
        f"a traceback: {said[-300:]}": "Traceback" in said,
        f"{after - seconds:.1f} s of processor time": after - seconds > PROCESSOR,
        f"{peak / 1000:.0f} MB, {most / 1000:.0f} are allowed": peak > most,
    }
    return "; ".join(text for text, is_wrong in wrong.items() if is_wrong)


def hand_over(name: str, option: str, variant: tuple[str, ...], folder: str) -> int:
    """Hand every hostile file to one option, in a process of its own; prints what went wrong."""
    paths: dict[str, str] = json.loads(Path(folder, "paths.json").read_text())
    work = Path(folder, "work", f"{name} {option} {len(variant)}")
    work.mkdir(parents=True)
    os.chdir(work)
    shutil.copytree(pretrained(DEFAULT), "shipped")
    Path("recording.mcap").write_bytes(ticks())
    for file in VENDOR:
        Path("packages", file).parent.mkdir(parents=True, exist_ok=True)
        Path("packages", file).touch()
    for module in (models, own_ground, scene_file):
        module.run_trial = remembered(module.run_trial, Path(folder))
    trial.STALL_INTERVAL = 1.0  # One file waits for another program.
    attempt(command_line(name, option, variant, "/nowhere"))  # Imports what it needs.
    reports, most = {}, usage()[1] + MEMORY
    for title, path in paths.items():
        signal.alarm(PATIENCE)
        Path("progress").write_text(title)
        accepted = any(part in title for part in ACCEPTED.get(name, ()))
        if problem := attempt(command_line(name, option, variant, path), most, accepted):
            reports[title] = problem
    print(json.dumps(reports))
    return 0


def remembered(run_trial: Callable[..., None], folder: Path) -> Callable[..., None]:
    """A trial whose verdict on a file of `folder` serves every command: a trial is slow.

    Verdicts are files, which all workers share.
    """
    verdicts = folder / "verdicts"

    def run(module: str, arguments: list[str], what: str, data: bytes = b"") -> None:
        # Each worker has the same files in a folder of its own.
        same = repr((module, arguments)).replace(str(folder), "").encode()
        verdict = verdicts / hashlib.sha256(same + data).hexdigest()
        if not verdict.exists():
            told = ""
            try:
                run_trial(module, arguments, "", data)
            except RenetError as error:
                told = str(error)
            # Whole or not at all, as another worker may look.
            partial = verdict.with_suffix(f".{os.getpid()}")
            partial.write_text(told)
            partial.rename(verdict)
        if refusal := verdict.read_text():
            raise RenetError(what + refusal)

    return run


def demand_no_harm(
    hostile: Path, fork: Fork, name: str, option: str, variant: tuple[str, ...]
) -> None:
    """Hand over in another process, and look at what has become of the user's files."""
    before = snapshot(hostile / "files")
    done = fork(hand_over, name, option, variant, str(hostile))
    progress = [path.read_text() for path in hostile.glob("work/*/progress")]
    assert done.returncode == 0, (done.returncode, done.stderr[-1500:], *progress)
    reports = json.loads(done.stdout.splitlines()[-1])
    assert not reports, "\n".join(f"{title}: {report}" for title, report in reports.items())
    assert snapshot(hostile / "files") == before
