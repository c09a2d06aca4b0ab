"""Loads a file of unknown origin in a process with limits, before this process loads it."""

import os
import resource
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from subprocess import DEVNULL, PIPE, run

from renet.errors import RenetError
from renet.files import MEGABYTE

MAX_MEMORY = 400 * MEGABYTE
"""Bytes that a trial may need beside the program's own."""
MAX_SECONDS = 3
"""Processor time in seconds that a trial may need beside the program's own start."""
PATIENCE = 5
"""Seconds of the wall clock from the start of the trial itself; it may wait, as for a pipe."""
ACCEPTED = "accepted"


def run_trial(module: str, arguments: list[str], what: str, data: bytes = b"") -> None:
    """Run `python -m module arguments`, which calls `judge`.

    Args:
        module: to run. arguments: of its command line. what: is tried, for messages.
        data: for its standard input.

    Raises:
        RenetError: the trial said what is wrong, or needed too much time or memory.
    """
    command = [sys.executable, "-P", "-m", module, *arguments]
    # Each thread's own heap reserves address space, which the limit counts.
    env = os.environ | {"MALLOC_ARENA_MAX": "1"}
    done = run(command, input=data, stdout=PIPE, stderr=DEVNULL, env=env)
    said = done.stdout.decode(errors="replace").strip()
    if said != ACCEPTED:
        limits = f"{MAX_SECONDS} s or {MAX_MEMORY / MEGABYTE:g} MB"
        raise RenetError(f"{what}: {said or f'it needs more than {limits}'}")


def judge(trial: Callable[[], str]) -> None:
    """Within a trial's process: run it under the limits and print what it found.

    Args:
        trial: returns what is wrong, or an empty text.
    """
    spent = resource.getrusage(resource.RUSAGE_SELF)
    seconds = int(spent.ru_utime + spent.ru_stime) + 1 + MAX_SECONDS
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
    if sys.platform == "linux":  # Others do not limit address space: what is promised counts, too.
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        most = pages * resource.getpagesize() + MAX_MEMORY
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.alarm(PATIENCE)  # Ends this process; imports on a busy computer do not count.
    out = os.dup(1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # Libraries' own words are no verdict.
    os.write(out, (trial() or ACCEPTED).encode())
