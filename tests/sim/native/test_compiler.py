"""C++ compiled by Warp: structs shared with Python, and calls that several threads work on."""

import ctypes
import gc
import threading
import weakref
from pathlib import Path

import numpy as np
import pytest
import warp as wp

from renet.sim import threads
from renet.sim.depth import rasterizer
from renet.sim.native import engine
from renet.sim.native.compiler import Call, Source

SOURCE = Source(Path(__file__).with_name("count.cpp"))


@wp.func_native(SOURCE.snippet("count", "Count"))
def _count(call: wp.uint64): ...


@wp.kernel
def count(call: wp.uint64):
    _count(call)


def counted(things: int, alone: bool = False) -> tuple[Call, np.ndarray, np.ndarray]:
    """A call, what it has done, and what each thread has."""
    done, worked = np.zeros(1000, np.float32), np.zeros(64, np.float32)
    argument = SOURCE.struct("Count")(
        flag=True,
        size=0,
        things=things,
        done=done,
        threads=worked,
    )
    return Call(count, argument, alone), done, worked


@pytest.mark.parametrize("things", [0, 1, 3, 1000])
@pytest.mark.parametrize("alone", [True, False])
def test_all_is_done_once_each_time(monkeypatch, things: int, alone: bool):
    monkeypatch.setattr(threads, "THREADS", 5)
    call, done, worked = counted(things, alone)
    for time in (1, 2, 3):
        call()
        assert (done[:things] == time).all()
        assert not done[things:].any()
        assert worked[0] == time
        assert not worked[1 if alone else 5 :].any()


def test_several_threads_work(monkeypatch):
    monkeypatch.setattr(threads, "THREADS", 2)
    call, _, worked = counted(0)
    launch, meeting = call._launch.launch, threading.Barrier(2, timeout=20)

    def wait_and_launch() -> None:
        meeting.wait()  # One thread alone never ends.
        launch()

    monkeypatch.setattr(call._launch, "launch", wait_and_launch)
    call._alone = False
    call()
    assert worked[:2].tolist() == [1.0, 1.0]


def test_fields_can_be_replaced_between_calls():
    call, first, _ = counted(9)
    second = np.zeros(64, np.float32)
    call.argument.set(done=second, things=4)
    call()
    assert not first.any()
    assert second.nonzero()[0].tolist() == [0, 1, 2, 3]


def test_python_and_c_lay_structs_out_alike():
    call, _, _ = counted(0)
    call()
    assert call.argument.size == ctypes.sizeof(SOURCE.struct("Count"))
    assert call.argument.flag == 0


def test_a_struct_keeps_alive_what_it_points_to():
    call, done, _ = counted(1000)
    gone = weakref.ref(done)
    del done
    gc.collect()
    assert gone() is not None
    call.argument.set(done=np.zeros(1000, np.float32))
    gc.collect()
    assert gone() is None


@pytest.mark.parametrize("fields", [{"threads": 0}, {"threads": 0, "taken": 0, "given": 0}])
def test_missing_and_misspelt_fields_are_refused(fields):
    with pytest.raises(TypeError, match=r"Work: missing or unknown"):
        SOURCE.struct("Work")(**fields)


def test_structs_python_cannot_share_are_refused():
    with pytest.raises(KeyError, match="Nothing"):
        SOURCE.struct("Nothing")
    with pytest.raises(KeyError, match="fields other than"):
        rasterizer.SOURCE.struct("Box")  # It has arrays.


@pytest.mark.parametrize("source", [engine.SOURCE, rasterizer.SOURCE])
def test_no_c_function_is_longer_than_a_screen(source):
    """50 lines, from its name to its closing brace."""
    bodies = source.text.split("\nstatic ")[1:]
    assert len(bodies) > 10
    assert max(body.split("\n}")[0].count("\n") for body in bodies) < 50
