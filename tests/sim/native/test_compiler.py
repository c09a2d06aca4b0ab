"""C++ compiled by Warp: structs shared with Python, and calls that several threads work on."""

import ctypes
import gc
import weakref
from pathlib import Path

import numpy as np
import pytest

from renet.sim import threads
from renet.sim.depth import rasterizer
from renet.sim.native.compiler import Source, Struct

SOURCE = Source(Path(__file__).with_name("count.cpp"))


def counter(things: int, waits_for: int = 0) -> tuple[Struct, np.ndarray, np.ndarray]:
    """What `count` is called with, what it has done, and what each thread has."""
    done, worked = np.zeros(1000, np.float32), np.zeros(64, np.float32)
    argument = SOURCE.struct("Count")(
        flag=True, size=0, things=things, waits_for=waits_for, done=done, threads=worked
    )
    return argument, done, worked


@pytest.mark.parametrize("things", [0, 1, 3, 1000])
@pytest.mark.parametrize("alone", [True, False])
def test_all_is_done_once_each_time(monkeypatch, things: int, alone: bool):
    monkeypatch.setattr(threads, "THREADS", 5)
    argument, done, worked = counter(things)
    for time in (1, 2, 3):
        SOURCE.call("count", argument, alone)
        assert (done[:things] == time).all()
        assert not done[things:].any()
        assert worked[0] == time
        assert not worked[1 if alone else 5 :].any()


def test_threads_share_structs_with_c(monkeypatch):
    monkeypatch.setattr(threads, "THREADS", 2)
    argument, _, worked = counter(0, waits_for=2)
    SOURCE.call("count", argument)
    assert worked[:2].tolist() == [1.0, 1.0]
    assert argument.size == ctypes.sizeof(SOURCE.struct("Count"))
    assert argument.flag == 0


def test_struct_keeps_pointees_alive():
    argument, done, _ = counter(1000)
    reference = weakref.ref(done)
    del done
    gc.collect()
    assert reference() is not None
    del argument
    gc.collect()
    assert reference() is None


def test_wrong_fields_are_refused():
    for fields in ({"threads": 0}, {"threads": 0, "taken": 0, "given": 0}):
        with pytest.raises(TypeError, match=r"Work: missing or unknown"):
            SOURCE.struct("Work")(**fields)
    with pytest.raises(KeyError, match="Nothing"):
        SOURCE.struct("Nothing")
    with pytest.raises(KeyError, match="fields other than"):
        rasterizer.RASTERIZER_SOURCE.struct("Box")  # It has arrays.
