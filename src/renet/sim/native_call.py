"""Functions in C that Warp compiles, called by threads that share out what there is to do."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp

from renet.sim.threads import THREADS, on_all_threads

SHARED = """
    typedef unsigned long long u64;
    u64* const shared = (u64*)(u64)call;
    const u64* const own = shared + 2;
    const int thread = (int)__atomic_fetch_add(shared, 1, __ATOMIC_RELAXED);
    auto take = [&](int n) { return (int)__atomic_fetch_add(shared + 1, n, __ATOMIC_RELAXED); };
"""
"""How such a function, whose argument `call` is the address of a Call's numbers, begins. It goes on
to read them from `own`, knows its `thread`, counted from 0, and asks `take(n)` for the first of the
next n things to do, until there are none."""


class Call:
    """A kernel around such a function, and the numbers it reads.

    To be made once and called often: what Warp's launch looks up and packs each time takes longer
    than a small call, for between two runs of physics all of it has left the cache.
    """

    def __init__(
        self, kernel: Any, numbers: Sequence[int], alone: bool = False, held: Any = None
    ) -> None:
        """Prepare a call.

        Args:
            kernel: its one argument is the call's address.
            numbers: counts and addresses; what they point to must outlive the call.
            alone: leave it to the calling thread, without the GIL in any case.
            held: what to keep alive for that.
        """
        self._held = held
        self._table = np.array([0, 0, *numbers], np.uint64)
        address = self._table.ctypes.data
        self._launch = wp.launch(kernel, dim=1, inputs=[address], device="cpu", record_cmd=True)
        self._alone = alone or THREADS == 1

    def __call__(self, last: Sequence[int] = ()) -> None:
        """Run it to its end; the last numbers can be replaced."""
        self._table[:2] = 0
        if last:
            self._table[-len(last) :] = last
        if self._alone:
            self._launch.launch()
        else:
            on_all_threads(self._launch.launch)
