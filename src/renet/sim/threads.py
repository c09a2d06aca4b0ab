"""One small thread pool for work that runs outside the GIL (Warp and MuJoCo on the CPU)."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

THREADS = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
CHUNKS_PER_THREAD = 4
"""Small enough chunks keep all threads busy when one is held up by a neighbour."""

_pool = ThreadPoolExecutor(THREADS, thread_name_prefix="renet")


def for_chunks(count: int, run: Callable[[int, int], None]) -> None:
    """Call `run(first, last)` over [0, count) in parallel; exceptions are raised here."""
    chunk = max(1, -(-count // (CHUNKS_PER_THREAD * THREADS)))
    starts = range(0, count, chunk)
    for _ in _pool.map(lambda first: run(first, min(first + chunk, count)), starts):
        pass
