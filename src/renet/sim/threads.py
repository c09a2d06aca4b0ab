"""One small thread pool for work that runs outside the GIL (Warp and MuJoCo on the CPU)."""

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager

import torch

THREADS = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1

_pool = ThreadPoolExecutor(THREADS, thread_name_prefix="renet")


def on_all_threads(work: Callable[[], None]) -> None:
    """Call `work` on several threads, the calling one among them; exceptions are raised here.

    The calls share out what there is to do. There may be as few as one: a thread that does not wake
    before another has finished is too late.
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
    """Small tensors on a CPU: waking a second thread costs more than it computes.

    Threads of this module's pool are not torch's and stay as they are.
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
