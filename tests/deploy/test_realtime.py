"""Priority of the control loop's thread and of others, memory and garbage collector."""

import gc
import os
import re
import sys
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar
from unittest.mock import Mock

import pytest

from renet.deploy import main, realtime
from renet.deploy.catalogue import SimulationCfg
from renet.deploy.loop import run_control_loop
from renet.pilot import inference

from .fakes import BRISK

pytestmark = pytest.mark.wall_clock


def scheduling(thread: int = 0) -> tuple[int, int]:
    """Policy and priority of a thread by the system's number, by default of the calling one."""
    return os.sched_getscheduler(thread), os.sched_getparam(thread).sched_priority


def test_this_thread_gets_priority_the_others_less_and_all_give_it_back():
    gc.unfreeze()  # The tests' own.
    go = threading.Event()
    other = threading.Thread(target=go.wait, args=(60,))
    other.start()
    before = scheduling(), scheduling(other.native_id), sys.getswitchinterval()
    with realtime.realtime(50) as refused:
        allowed = "real-time priority" not in refused
        if allowed:
            assert scheduling() == (os.SCHED_FIFO, 50)
            # The loop waits while another thread of Python holds the interpreter's lock.
            assert scheduling(other.native_id) == (os.SCHED_FIFO, 40)
        assert sys.getswitchinterval() < 0.001
        assert not gc.isenabled()
        assert gc.get_freeze_count() > 0
    assert (scheduling(), scheduling(other.native_id), sys.getswitchinterval()) == before
    go.set()
    other.join()
    assert gc.isenabled()
    assert gc.get_freeze_count() == 0
    assert re.search(r"VmLck:\s+0 kB", Path("/proc/self/status").read_text())
    if not allowed:
        pytest.skip("the system refuses real-time priority")


def test_a_thread_that_ends_meanwhile_hinders_nothing():
    go = threading.Event()
    other = threading.Thread(target=go.wait, args=(60,))
    other.start()
    before = scheduling()
    with realtime.realtime(50):
        go.set()
        other.join()
    assert scheduling() == before


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
    main.deploy(main.DeployCfg(out=tmp_path, robot_cfg=driver, **options))
    if loop[0][0] != os.SCHED_FIFO:
        pytest.skip("the system refuses real-time priority")
    assert loop == [(os.SCHED_FIFO, main.PRIORITY)]
    # The checklist of a dry run times the models on the main thread.
    ticks = {how for thread, how in vision if thread is not threading.main_thread()}
    assert ticks == set(loop)
