"""Folders of runs: where a new one begins, which one goes on, and how one is stopped."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime
from itertools import chain, count
from pathlib import Path
from typing import Any

from renet.errors import RenetError, reason
from renet.folders import new_folder
from renet.options import LOGS, resumed_folder
from renet.training import checkpoint as checkpoints
from renet.training.runner import CHECKPOINTS


def resumed_run(checkpoint: Path | None, root: Path | None) -> Path | None:
    """The run that goes on from a checkpoint; None where a new one begins.

    A new one begins without a checkpoint, from one that is not its run's newest or in no run's
    folder, and where `root`, which is `--log-root`, is not the run's.
    """
    if checkpoint is None or checkpoint.parent.name != CHECKPOINTS:
        return None
    run = checkpoint.parent.parent
    elsewhere = root is not None and run.resolve().parent.parent != root.resolve()
    newest = checkpoints.checkpoints(checkpoint.parent)[-1:]  # None of a copy with another name.
    return None if elsewhere or newest != [checkpoint] else run


def new_run(root: Path | None, experiment: str, name: str = "") -> Path:
    """Create `root/experiment/date_time_name`, by default in `logs`; raises RenetError."""
    if "/" in name or not name.isprintable():  # A stranger's checkpoint may hold any.
        raise RenetError(f"agent.run-name must be no path, got {name!r}")
    root = root or LOGS
    stamp = datetime.now().strftime("%Y-%m-%d_%H-%M-%S") + (f"_{name}" if name else "")
    # A second number for runs begun in the same second.
    for folder in chain([stamp], (f"{stamp}_{n}" for n in count(2))):
        try:
            return new_folder(root / experiment / folder)
        except FileExistsError as error:
            if not (root / experiment).is_dir():
                why = f"{root / experiment} is no folder: choose another --log-root"
                raise RenetError(why) from error
        except OSError as error:
            why = f"cannot write to {root}: {reason(error)}. Choose another --log-root"
            raise RenetError(why) from error
    raise AssertionError


def resolve_resume(resume: str, root: Path | None, experiment: str) -> Path:
    """The checkpoint folder that `--resume` names; raises RenetError if there is none."""
    return checkpoints.find(resumed_folder(resume, root, experiment))


@contextmanager
def signals(stop: Callable[[int], None]) -> Iterator[None]:
    """Call `stop` with the number of the first Ctrl-C or TERM; the next one acts as ever."""
    if threading.current_thread() is not threading.main_thread():  # It alone hears signals.
        yield
        return
    before: dict[int, Any] = {}

    def handle(number: int, _: Any) -> None:
        for each, handler in before.items():
            signal.signal(each, handler)
        stop(number)

    for number in (signal.SIGINT, signal.SIGTERM):
        before[number] = signal.signal(number, handle)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
