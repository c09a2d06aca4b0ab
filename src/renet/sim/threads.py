"""Thread pool for work that releases the GIL (Warp and MuJoCo on the CPU)."""

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager

import torch

THREADS = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
"""Number of CPUs that this process may use."""

_pool = ThreadPoolExecutor(THREADS, thread_name_prefix="renet")


def on_all_threads(work: Callable[[], None]) -> None:
    """Call a function on up to `THREADS` threads, among them the calling one.

    The calls must divide the work among themselves. A thread that wakes after the first call has
    finished is not used. Exceptions of any call are raised.
    """
    futures = [_pool.submit(work) for _ in range(THREADS - 1)]
    try:
        work()
    finally:
        # All work is done: calls that have not begun are not needed.
        wait([future for future in futures if not future.cancel()])
    for future in futures:
        if not future.cancelled():
            future.result()


@contextmanager
def one_torch_thread(device: str | torch.device) -> Iterator[None]:
    """Context in which torch uses one thread on a CPU: for small tensors a second one is slower.

    The threads of this module's pool are not changed.
    """
    threads = torch.get_num_threads()
    if torch.device(device).type != "cpu" or threads == 1:
        yield
        return
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)
