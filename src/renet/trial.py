"""Loads a file of unknown origin in a process with limits, before this process loads it."""

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
"""Bytes that a trial may need beside the program's own."""
MAX_SECONDS = 3
"""Processor time in seconds that a trial may need beside the program's own start."""
PATIENCE = 5.0
"""Seconds of the wall clock, for a tenth of which a trial must run or wait for a processor: a busy
computer may be slow, but a trial that waits for another program is ended."""
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
    with open(os.memfd_create("trial"), "wb+") as memory:  # Writing cannot block, as to a pipe.
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
    """What a trial says, or why it ended without a word."""
    active = 0.0
    while True:
        try:
            output, _ = process.communicate(timeout=PATIENCE)
            break
        except TimeoutExpired:
            before, active = active, _active_seconds(process.pid)
            if active - before < 0.1 * PATIENCE:
                return (
                    f"it did nothing for {PATIENCE:g} s: it waits for another program, or this "
                    "computer's disk is too busy (then try again)"
                )
    if output:
        return output.decode(errors="replace").strip()
    if -process.returncode in (signal.SIGXCPU, signal.SIGKILL):
        return f"it needs more than {MAX_SECONDS} s of processor time"
    return f"it crashes, or needs more than {MAX_MEMORY / MEGABYTE:g} MB of memory"


def _active_seconds(pid: int) -> float:
    """How long the threads of a process have run, or waited for a processor."""
    texts = [path.read_text() for path in Path(f"/proc/{pid}/task").glob("*/schedstat")]
    return sum(int(number) for text in texts for number in text.split()[:2]) / 1e9


def judge(trial: Callable[[], str]) -> None:
    """Within a trial's process: run it under the limits and print its verdict.

    Args:
        trial: returns what is wrong, or an empty text.
    """
    usage = resource.getrusage(resource.RUSAGE_SELF)
    seconds = int(usage.ru_utime + usage.ru_stime) + 1 + MAX_SECONDS
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
    if sys.platform == "linux":  # Others do not limit address space: what is promised counts, too.
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        most = pages * resource.getpagesize() + MAX_MEMORY
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    out = os.dup(1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # Libraries' own words are no verdict.
    try:
        verdict = trial() or ACCEPTED
    except MemoryError:
        verdict = f"it needs more than {MAX_MEMORY / MEGABYTE:g} MB of memory"
    os.write(out, verdict.encode())
