"""A thread pool for work that releases the GIL (Warp and MuJoCo on the CPU)."""

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager

import torch

THREADS = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1

_pool = ThreadPoolExecutor(THREADS, thread_name_prefix="renet")


def on_all_threads(work: Callable[[], None]) -> None:
    """Call `work` on up to `THREADS` threads, among them the calling one; raises its exceptions.

    The calls share the work among themselves. A thread that wakes after the first call has finished
    is not used.
    """
    others = [_pool.submit(work) for _ in range(THREADS - 1)]
    try:
        work()
    finally:
        wait([other for other in others if not other.cancel()])
    for other in others:
        if not other.cancelled():
            other.result()


@contextmanager
def one_torch_thread(device: str | torch.device) -> Iterator[None]:
    """Let torch use one thread on a CPU: for small tensors, waking a second costs more time.

    This does not change the threads of this module's pool.
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
