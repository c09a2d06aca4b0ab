"""Trial of a file of unknown origin in a process with limits, before this process loads it."""

import os
import resource
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from subprocess import DEVNULL, PIPE, Popen, TimeoutExpired

from renet.errors import RenetError
from renet.files import MEGABYTE

MAX_MEMORY = 400 * MEGABYTE
"""Memory that a trial may use beyond the program's own, bytes."""
MAX_SECONDS = 3
"""Processor time that a trial may use after the program's start, s."""
STALL_INTERVAL = 5.0
"""Time of the wall clock, for a tenth of which a trial must run or wait for a processor, s. It may
be slow on a busy computer, but is ended if it waits for another program."""
ACCEPTED = "accepted"
"""Verdict on a file that can be loaded."""


def run_trial(module: str, arguments: list[str], what: str, data: bytes = b"") -> None:
    """Run `python -m module arguments`, which calls `judge`.

    Args:
        module: Module to run.
        arguments: Arguments of its command line.
        what: Description of the file for messages.
        data: Bytes for its standard input.

    Raises:
        RenetError: The file cannot be loaded, or the trial needed too much time or memory.
    """
    command = [sys.executable, "-P", "-m", module, *arguments]
    # Each thread's own heap reserves address space, which the limit counts.
    env = os.environ | {"MALLOC_ARENA_MAX": "1"}
    # Writing to memory cannot block, as writing to a pipe can.
    with open(os.memfd_create("trial"), "wb+") as memory:
        memory.write(data)
        memory.seek(0)
        with Popen(command, stdin=memory, stdout=PIPE, stderr=DEVNULL, env=env) as process:
            try:
                verdict = _wait(process)
            finally:
                process.kill()
    if verdict != ACCEPTED:
        raise RenetError(f"{what}: {verdict}")


def _wait(process: Popen) -> str:
    """Wait for a trial, and return its verdict, or the reason why it has none."""
    active = 0.0
    while True:
        try:
            output, _ = process.communicate(timeout=STALL_INTERVAL)
            break
        except TimeoutExpired:
            before = active
            active = _active_seconds(process.pid)
            if active - before < 0.1 * STALL_INTERVAL:
                return (
                    f"it did nothing for {STALL_INTERVAL:g} s: it waits for another program, or "
                    "this computer's disk is too busy (then try again)"
                )
    if output:
        return output.decode(errors="replace").strip()
    if -process.returncode in (signal.SIGXCPU, signal.SIGKILL):
        return f"it needs more than {MAX_SECONDS} s of processor time"
    return f"it crashes, or needs more than {MAX_MEMORY / MEGABYTE:g} MB of memory"


def _active_seconds(pid: int) -> float:
    """Return the time for which the threads of a process have run or waited for a processor, s."""
    nanoseconds = 0
    for path in Path(f"/proc/{pid}/task").glob("*/schedstat"):
        running, waiting = path.read_text().split()[:2]
        nanoseconds += int(running) + int(waiting)
    return nanoseconds / 1e9


def judge(trial: Callable[[], str]) -> None:
    """Run a trial under the limits and print its verdict, in a process of its own.

    Args:
        trial: Function that returns the error in the file, or an empty text.
    """
    # The limit on time counts from the program's start.
    usage = resource.getrusage(resource.RUSAGE_SELF)
    seconds = int(usage.ru_utime + usage.ru_stime) + 1 + MAX_SECONDS
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
    # Other systems do not limit address space, which includes memory that is only reserved.
    if sys.platform == "linux":
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        most = pages * resource.getpagesize() + MAX_MEMORY
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    # Libraries may print, too, which must not be taken for the verdict.
    out = os.dup(1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    try:
        verdict = trial() or ACCEPTED
    except MemoryError:
        verdict = f"it needs more than {MAX_MEMORY / MEGABYTE:g} MB of memory"
    os.write(out, verdict.encode())
