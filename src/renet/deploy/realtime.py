"""Real-time help of the operating system for a control loop, where it is allowed."""

import ctypes
import gc
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

_LOCK_ALL = 3
"""Linux' MCL_CURRENT | MCL_FUTURE."""
_BELOW = 10
"""Difference between the priorities of the control loop and of the other threads."""
_SWITCH_INTERVAL = 0.0005
"""Time after which a thread that computes in Python hands the interpreter over, s. Python's own
value, 5 ms, is a quarter of a control step."""


@contextmanager
def realtime(priority: int) -> Iterator[str]:
    """Run a block on this thread with real-time priority, locked memory and no garbage collector.

    This thread, and threads that it starts, get the SCHED_FIFO priority `priority`, 1 to 99. Other
    threads of Python get a lower one: this thread waits for the one that holds the interpreter's
    lock, and without priority that one may wait for any other program.

    Yields:
        A line that says what the system refused; empty if it granted all. The collector always
        stops.
    """
    refused = []
    before = _scheduling()
    this = threading.get_native_id()
    try:
        threads = dict.fromkeys(before, (os.SCHED_FIFO, max(priority - _BELOW, 1)))
        threads[this] = (os.SCHED_FIFO, priority)
        _schedule(threads)
    except OSError as error:
        refused.append(f"real-time priority ({error.strerror})")
    if ctypes.CDLL(None, use_errno=True).mlockall(_LOCK_ALL):
        refused.append(f"locked memory ({os.strerror(ctypes.get_errno())})")
    # Objects of the start are never garbage: frozen, they cost the collector nothing afterwards.
    collecting = gc.isenabled()
    gc.collect()
    gc.freeze()
    gc.disable()
    interval = sys.getswitchinterval()
    sys.setswitchinterval(_SWITCH_INTERVAL)
    try:
        yield f"the system refused {' and '.join(refused)}" if refused else ""
    finally:
        sys.setswitchinterval(interval)
        if collecting:
            gc.enable()
        gc.unfreeze()
        ctypes.CDLL(None).munlockall()
        _schedule(before)


def _scheduling() -> dict[int, tuple[int, int]]:
    """Return policy and priority of each of Python's threads, by the system's number of it."""
    found = {}
    for thread in threading.enumerate():
        # A thread may have just ended.
        with suppress(ProcessLookupError):
            if thread.native_id is not None:
                found[thread.native_id] = _scheduling_of(thread.native_id)
    return found


def _scheduling_of(thread: int) -> tuple[int, int]:
    return os.sched_getscheduler(thread), os.sched_getparam(thread).sched_priority


def _schedule(threads: dict[int, tuple[int, int]]) -> None:
    """Give threads their policies and priorities; raises OSError if the system refuses."""
    for thread, (policy, priority) in threads.items():
        with suppress(ProcessLookupError):
            if _scheduling_of(thread) != (policy, priority):
                os.sched_setscheduler(thread, policy, os.sched_param(priority))
