"""Calls into C: each thing is done once, by as many threads as come."""

from __future__ import annotations

import threading

import numpy as np
import pytest
import warp as wp

from renet.sim import threads
from renet.sim.native.compiler import SHARED, Call


@wp.func_native(
    SHARED
    + """
    float* const done = (float*)own[1];
    float* const threads = (float*)own[2];
    threads[thread] += 1.0f;
    for (int first; (first = take(3)) < (int)own[0];)
        for (int i = first; i < first + 3 && i < (int)own[0]; ++i) done[i] += 1.0f;
    """
)
def _count(call: wp.uint64): ...


@wp.kernel
def count(call: wp.uint64):
    _count(call)


@pytest.mark.parametrize("things", [0, 1, 3, 1000])
@pytest.mark.parametrize("alone", [True, False])
def test_all_is_done_once_each_time(monkeypatch, things: int, alone: bool):
    monkeypatch.setattr(threads, "THREADS", 5)
    done, worked = np.zeros(1000, np.float32), np.zeros(64, np.float32)
    call = Call(count, (things, done.ctypes.data, worked.ctypes.data), alone)
    for time in (1, 2, 3):
        call()
        assert (done[:things] == time).all()
        assert not done[things:].any()
        assert worked[0] == time
        assert not worked[1 if alone else 5 :].any()


def test_several_threads_work(monkeypatch):
    monkeypatch.setattr(threads, "THREADS", 2)
    done, worked = np.zeros(1, np.float32), np.zeros(2, np.float32)
    call = Call(count, (0, done.ctypes.data, worked.ctypes.data))
    launch, meeting = call._launch.launch, threading.Barrier(2, timeout=20)

    def wait_and_launch() -> None:
        meeting.wait()  # One thread alone never ends.
        launch()

    monkeypatch.setattr(call._launch, "launch", wait_and_launch)
    call._alone = False
    call()
    assert worked.tolist() == [1.0, 1.0]


def test_the_last_numbers_can_be_others():
    first, second, worked = np.zeros((3, 64), np.float32)
    call = Call(count, (9, first.ctypes.data, worked.ctypes.data))
    call((second.ctypes.data, worked.ctypes.data))
    assert not first.any()
    assert (second[:9] == 1.0).all()
