"""What the operating system can do for a control loop, where it allows it."""

import ctypes
import gc
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

LOCK_ALL = 3
"""MCL_CURRENT | MCL_FUTURE of Linux."""
BELOW = 10
"""By how much the priority of other threads is lower than the control loop's."""
SWITCH_INTERVAL = 0.0005
"""Seconds after which a thread that computes in Python hands the interpreter over; 5 ms if nobody
sets it, a quarter of a control step."""


@contextmanager
def realtime(priority: int) -> Iterator[str]:
    """Run a block on this thread with real-time priority, locked memory and no garbage collector.

    This thread, and threads it starts, get the priority of SCHED_FIFO, 1 to 99, and all other
    threads of Python a lower one: this thread waits for whichever holds the interpreter's lock, and
    so for whatever program had pushed that one aside. Yields in one line what the system refused,
    empty if it granted all; the collector always stops.
    """
    refused = []
    before = _scheduling()
    this = threading.get_native_id()
    try:
        lower = os.SCHED_FIFO, max(priority - BELOW, 1)
        _schedule({**dict.fromkeys(before, lower), this: (os.SCHED_FIFO, priority)})
    except OSError as error:
        refused.append(f"real-time priority ({error.strerror})")
    if ctypes.CDLL(None, use_errno=True).mlockall(LOCK_ALL):
        refused.append(f"locked memory ({os.strerror(ctypes.get_errno())})")
    collecting = gc.isenabled()
    gc.collect()
    gc.freeze()
    gc.disable()
    interval = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH_INTERVAL)
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
    """Policy and priority of every thread of Python, by the system's number of the thread."""
    found = {}
    for thread in threading.enumerate():
        with suppress(ProcessLookupError):  # It has just ended.
            if thread.native_id is not None:
                found[thread.native_id] = _scheduling_of(thread.native_id)
    return found


def _scheduling_of(thread: int) -> tuple[int, int]:
    return os.sched_getscheduler(thread), os.sched_getparam(thread).sched_priority


def _schedule(threads: dict[int, tuple[int, int]]) -> None:
    """Give threads a policy and a priority; raises OSError if the system refuses."""
    for thread, (policy, priority) in threads.items():
        with suppress(ProcessLookupError):
            if _scheduling_of(thread) != (policy, priority):
                os.sched_setscheduler(thread, policy, os.sched_param(priority))
