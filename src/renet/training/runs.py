"""Folders of new and resumed runs, and the signals that stop one."""

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
from renet.options import LOGS
from renet.training import checkpoint as checkpoints
from renet.training.runner import CHECKPOINTS


def resumed_run(checkpoint: Path | None, root: Path | None) -> Path | None:
    """Return the folder of the run that continues from a checkpoint, or None for a new run.

    A new run begins without a checkpoint, from one that is not its run's newest or in no run's
    folder, and if the run is not below `root`.

    Args:
        checkpoint: Folder of the checkpoint.
        root: Folder of all runs that the user chose by `--log-root`, or None.
    """
    if checkpoint is None:
        return None
    # From within the run a checkpoint may be given by its own name alone, or by a dot.
    if checkpoint.parent.name != CHECKPOINTS:
        checkpoint = checkpoint.absolute()
    if checkpoint.parent.name != CHECKPOINTS:
        return None
    run = checkpoint.parent.parent
    if root is not None and run.resolve().parent.parent != root.resolve():
        return None
    # Empty for a copy under another name than a checkpoint's.
    newest = checkpoints.checkpoints(checkpoint.parent)[-1:]
    return run if newest == [checkpoint] else None


def new_run(root: Path | None, experiment: str, name: str) -> Path:
    """Create the folder `root/experiment/date_time_name` of a new run.

    Args:
        root: Folder of all runs, by default `logs`.
        experiment: Name of the experiment.
        name: Name of the run, or an empty text.

    Raises:
        RenetError: The name is a path, or the folder cannot be created.
    """
    # The name may come from a stranger's checkpoint.
    if "/" in name or not name.isprintable():
        raise RenetError(f"agent.run-name must be no path, got {name!r}")
    root = root or LOGS
    stem = datetime.now().strftime("%Y-%m-%d_%H-%M-%S")
    if name:
        stem += f"_{name}"
    # Runs that begin in the same second get a number.
    candidates = chain([stem], (f"{stem}_{number}" for number in count(2)))
    for folder in candidates:
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


@contextmanager
def signals(stop: Callable[[int], None]) -> Iterator[None]:
    """Context in which the first Ctrl-C, TERM or HUP calls `stop` with the signal's number.

    HUP is what a terminal sends that closes. Where it is ignored, as below `nohup`, it stays so.
    A second signal acts as it does outside the context, except HUP, which a terminal may send more
    than once: it is ignored from the first signal on.
    """
    # Python handles signals on the main thread alone.
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    old_handlers: dict[int, Any] = {}

    def restore_handlers() -> None:
        for number, handler in old_handlers.items():
            signal.signal(number, handler)

    def handle(number: int, _: Any) -> None:
        restore_handlers()
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
        stop(number)

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        old_handlers[number] = signal.signal(number, handle)
    if old_handlers[signal.SIGHUP] == signal.SIG_IGN:
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        yield
    finally:
        restore_handlers()
