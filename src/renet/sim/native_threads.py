"""Threads for functions in C that Warp compiles: no interpreter to wake, no lock to wait for.

A thread made anew starts within 30 us. One of Python's, woken between small tensors, whose code is
then out of the cache, takes ten times as long.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp

from renet.sim.threads import THREADS

MOST = 64
"""Threads of one call."""

_process = ctypes.CDLL(None)


def in_threads(body: str) -> str:
    """C that runs `body` in all threads of a `Call`, whose address its function gets as `call`.

    `body` reads the call's numbers from `own` (u64), knows its `thread`, counted from 0, and asks
    `take(n)` for the first of the next n things to do, until there are none.
    """
    return (
        """
    typedef unsigned long long u64;
    auto work = [](void* argument) -> void* {
        u64* const head = (u64*)argument;
        const u64* const own = head + 5;
        const int thread = (int)__atomic_fetch_add(head + 3, 1, __ATOMIC_RELAXED);
        auto take = [&](int n) { return (int)__atomic_fetch_add(head + 4, n, __ATOMIC_RELAXED); };
        """
        + body
        + """
        return nullptr;
    };
    typedef signed status;  // Warp defines int( as a macro.
    typedef status (*create_function)(u64*, const void*, void* (*)(void*), void*);
    typedef status (*join_function)(u64, void**);
    u64* const head = (u64*)(u64)call;
    const create_function create = (create_function)head[0];
    const join_function join = (join_function)head[1];
    head[3] = head[4] = 0;
    u64 others[64];
    int made = 0;
    while (made < (int)head[2] && create(others + made, nullptr, work, head) == 0) ++made;
    work(head);
    for (int i = 0; i < made; ++i) join(others[i], nullptr);
    """
    )


class Call:
    """A kernel around a function of `in_threads`, and the numbers it reads.

    To be made once and called often: making it takes Warp longer than a small call.
    """

    def __init__(self, kernel: Any, numbers: Sequence[int], threads: int = THREADS) -> None:
        """Prepare a call.

        Args:
            kernel: its one argument is the call's address.
            numbers: counts and addresses; what they point to must outlive the call.
            threads: including the calling one.
        """
        others = min(threads, MOST) - 1
        head = [_address("pthread_create"), _address("pthread_join"), others, 0, 0]
        self._table = np.array([*head, *numbers], np.uint64)
        self._launch = wp.launch(
            kernel, dim=1, inputs=[self._table.ctypes.data], device="cpu", record_cmd=True
        )

    def __call__(self, last: Sequence[int] = ()) -> None:
        """Run it to its end, without the GIL; the last numbers can be replaced."""
        if last:
            self._table[-len(last) :] = last
        self._launch.launch()


def _address(function: str) -> int:
    return ctypes.cast(getattr(_process, function), ctypes.c_void_p).value or 0
