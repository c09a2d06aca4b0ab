"""Priority, memory and garbage collector of the control loop's thread alone."""

import gc
import os
import threading
from pathlib import Path

from renet.deploy import main, realtime


def scheduler_of(thread: int) -> int:
    return os.sched_getscheduler(thread)


def test_the_calling_thread_alone_gets_priority_and_gives_it_back():
    go, ids = threading.Event(), []
    other = threading.Thread(target=lambda: (ids.append(threading.get_native_id()), go.wait(60)))
    other.start()
    before = scheduler_of(0)
    with realtime.realtime(1) as refused:
        inside = scheduler_of(0)
        assert (inside == os.SCHED_FIFO) != ("real-time priority" in refused)
        assert scheduler_of(ids[0]) == before, "recorder, terminal and camera keep theirs"
        assert not gc.isenabled()
        assert gc.get_freeze_count() > 0
    go.set()
    other.join()
    assert scheduler_of(0) == before
    assert gc.isenabled()
    assert gc.get_freeze_count() == 0
    locked = [
        line for line in Path("/proc/self/status").read_text().splitlines() if "VmLck" in line
    ]
    assert locked[0].split()[1] == "0"


def test_a_system_that_refuses_is_quoted(monkeypatch):
    def refuse(*arguments):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    with realtime.realtime(50) as refused:
        assert "real-time priority (Operation not permitted)" in refused


def test_a_simulation_does_not_ask(tmp_path, monkeypatch):
    monkeypatch.setattr(main, "realtime", None)  # Nothing that could be called.
    main.deploy(main.DeployCfg(out=tmp_path, seconds=0.1))
