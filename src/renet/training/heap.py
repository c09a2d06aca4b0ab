"""Memory that training frees in one iteration and takes again in the next stays the process's."""

from __future__ import annotations

import ctypes

TRIM_THRESHOLD, MMAP_MAX, ARENA_MAX = -1, -4, -8
"""Parameters of glibc's `mallopt`, from its malloc.h."""
NEVER = 2**31 - 1


def keep_freed_memory() -> bool:
    """Keep what is freed, in one heap for all threads, however large; False without glibc.

    By default large tensors are mapped anew each time, and the kernel clears every page of them
    once more.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):  # macOS, musl, Windows.
        return False
    wanted = ((TRIM_THRESHOLD, NEVER), (MMAP_MAX, 0), (ARENA_MAX, 1))
    return all([mallopt(*parameter) for parameter in wanted])
