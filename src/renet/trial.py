"""Tries something a stranger wrote in a process of its own, with limits, before it is done here."""

import os
import resource
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from renet.errors import RenetError
from renet.files import MEGABYTE

MAX_MEMORY = 400 * MEGABYTE
"""Bytes that a trial may need beside the program's own."""
MAX_SECONDS = 3
"""Processor time in seconds that a trial may need beside the program's own start."""
PATIENCE = 5.0
"""Seconds of the wall clock from the start of the trial itself; it may wait, as for a pipe."""
ACCEPTED, STARTED = "accepted", "started"


def run_trial(module: str, arguments: list[str], what: str, data: bytes = b"") -> None:
    """Run `python -m module arguments`, which calls `judge`.

    Args:
        module: to run. arguments: of its command line. what: is tried, for messages.
        data: for its standard input.

    Raises:
        RenetError: the trial said what is wrong, or needed too much time or memory.
    """
    child = subprocess.Popen(
        [sys.executable, "-P", "-m", module, *arguments],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )
    assert child.stdin is not None
    assert child.stdout is not None
    try:
        with child.stdin as stdin:
            stdin.write(data)
        child.stdout.readline()  # The trial begins: imports on a busy computer do not count.
        child.wait(PATIENCE)
    except (BrokenPipeError, subprocess.TimeoutExpired):
        child.kill()
    with child.stdout as stdout:
        said = stdout.read().decode(errors="replace").strip()
    child.wait()
    if said != ACCEPTED:
        limits = f"{MAX_SECONDS} s or {MAX_MEMORY / MEGABYTE:g} MB"
        raise RenetError(f"{what}: {said or f'it needs more than {limits}'}")


def judge(trial: Callable[[], str]) -> None:
    """Within a trial's process: run it under the limits and print what it found.

    Args:
        trial: returns what is wrong, or an empty text; RenetErrors count as that, too.
    """
    spent = resource.getrusage(resource.RUSAGE_SELF)
    seconds = int(spent.ru_utime + spent.ru_stime) + 1 + MAX_SECONDS
    # Address space: what is only promised counts, too.
    mapped = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    most = mapped + MAX_MEMORY
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    out = os.dup(1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # Libraries' own words are no verdict.
    os.write(out, f"{STARTED}\n".encode())
    try:
        said = trial() or ACCEPTED
    except RenetError as error:
        said = str(error)
    os.write(out, said.encode())
