"""Priority, memory and garbage collector of the control loop's thread alone."""

import gc
import os
import re
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar
from unittest.mock import Mock

import pytest

from renet.deploy import inference, main, realtime
from renet.deploy.catalogue import SimulationCfg
from renet.deploy.loop import run_control_loop

from .fakes import BRISK


def test_the_calling_thread_alone_gets_priority_and_gives_it_back():
    gc.unfreeze()  # The tests' own.
    go, ids = threading.Event(), []
    other = threading.Thread(target=lambda: (ids.append(threading.get_native_id()), go.wait(60)))
    other.start()
    before = os.sched_getscheduler(0)
    with realtime.realtime(1) as refused:
        inside = os.sched_getscheduler(0)
        assert (inside == os.SCHED_FIFO) != ("real-time priority" in refused)
        assert os.sched_getscheduler(ids[0]) == before, "recorder, terminal and camera keep theirs"
        assert not gc.isenabled()
        assert gc.get_freeze_count() > 0
    go.set()
    other.join()
    assert os.sched_getscheduler(0) == before
    assert gc.isenabled()
    assert gc.get_freeze_count() == 0
    assert re.search(r"VmLck:\s+0 kB", Path("/proc/self/status").read_text())


def test_a_system_that_refuses_is_quoted(monkeypatch):
    refuse = Mock(side_effect=PermissionError(1, "Operation not permitted"))
    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    with realtime.realtime(50) as refused:
        assert "real-time priority (Operation not permitted)" in refused


def test_a_simulation_does_not_ask(tmp_path, monkeypatch):
    monkeypatch.setattr(main, "realtime", None)  # Nothing that could be called.
    main.deploy(main.DeployCfg(out=tmp_path, seconds=0.1))


@dataclass(frozen=True)
class PhysicalCfg(SimulationCfg):
    """A robot that takes itself for a real one."""

    simulated: ClassVar[bool] = False


def scheduling() -> tuple[int, int]:
    """Policy and priority of the calling thread."""
    return os.sched_getscheduler(0), os.sched_getparam(0).sched_priority


def test_the_loop_waits_for_a_vision_thread_of_its_own_priority(tmp_path, monkeypatch):
    loop, vision = [], []
    infer = inference.infer

    def watched_infer(*arguments):
        vision.append((threading.current_thread(), scheduling()))
        return infer(*arguments)

    def watched_loop(*arguments, **options):
        loop.append(scheduling())
        run_control_loop(*arguments, **options)

    monkeypatch.setattr(inference, "infer", watched_infer)
    monkeypatch.setattr(main, "run_control_loop", watched_loop)
    driver = PhysicalCfg(real_time=True)
    options = {"camera": "none", "dry_run": True, "safety": BRISK, "seconds": 1.0}
    main.deploy(main.DeployCfg(out=tmp_path, driver=driver, **options))
    if loop[0][0] != os.SCHED_FIFO:
        pytest.skip("the system refuses real-time priority")
    assert loop == [(os.SCHED_FIFO, main.PRIORITY)]
    thread, _ = vision[0]
    assert thread is not threading.main_thread()
    assert {how for _, how in vision} == set(loop)
