"""Threads in C: each thing is done once, by as many threads as there are."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from renet.sim import native_threads
from renet.sim.native_threads import Call, in_threads


@wp.func_native(
    in_threads(
        """
        float* const done = (float*)own[1];
        float* const threads = (float*)own[2];
        threads[thread] += 1.0f;
        for (int first; (first = take(3)) < (int)own[0];)
            for (int i = first; i < first + 3 && i < (int)own[0]; ++i) done[i] += 1.0f;
        """
    )
)
def _count(call: wp.uint64): ...


@wp.kernel
def count(call: wp.uint64):
    _count(call)


@pytest.mark.parametrize("things", [0, 1, 3, 1000])
@pytest.mark.parametrize("threads", [1, 2, 5])
def test_all_is_done_once_by_all_threads_each_time(things: int, threads: int):
    done, worked = np.zeros(1000, np.float32), np.zeros(64, np.float32)
    call = Call(count, (things, done.ctypes.data, worked.ctypes.data), threads)
    for time in (1, 2, 3):
        call()
        assert (done[:things] == time).all()
        assert not done[things:].any()
        assert (worked[:threads] == time).all()
        assert not worked[threads:].any()


def test_no_more_threads_than_it_has_room_for():
    done, worked = np.zeros(1000, np.float32), np.zeros(1000, np.float32)
    Call(count, (1000, done.ctypes.data, worked.ctypes.data), threads=900)()
    assert worked.sum() == native_threads.MOST
    assert (done == 1.0).all()


def test_the_caller_does_it_where_the_machine_makes_no_threads():
    done, worked = np.zeros(1000, np.float32), np.zeros(64, np.float32)
    call = Call(count, (1000, done.ctypes.data, worked.ctypes.data), threads=2)
    call._table[0] = native_threads._address("abs")  # Anything but 0: none was made.
    call()
    assert worked.tolist() == [1.0] + [0.0] * 63
    assert (done == 1.0).all()
