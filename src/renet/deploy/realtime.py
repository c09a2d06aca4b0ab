"""What the operating system can do for a control loop, where it allows it."""

import ctypes
import gc
import os
from collections.abc import Iterator
from contextlib import contextmanager

LOCK_ALL = 3
"""MCL_CURRENT | MCL_FUTURE of Linux."""


@contextmanager
def realtime(priority: int) -> Iterator[str]:
    """Run a block on this thread with real-time priority, locked memory and no garbage collector.

    Only this thread, and threads it starts, get the priority of SCHED_FIFO, 1 to 99. Yields in one
    line what the system refused, empty if it granted all; the collector always stops.
    """
    refused = []
    before, order = os.sched_getparam(0), os.sched_getscheduler(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError as error:
        refused.append(f"real-time priority ({error.strerror})")
    if ctypes.CDLL(None, use_errno=True).mlockall(LOCK_ALL):
        refused.append(f"locked memory ({os.strerror(ctypes.get_errno())})")
    collecting = gc.isenabled()
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield f"the system refused {' and '.join(refused)}" if refused else ""
    finally:
        if collecting:
            gc.enable()
        gc.unfreeze()
        ctypes.CDLL(None).munlockall()
        if os.sched_getscheduler(0) != order:
            os.sched_setscheduler(0, order, before)
