"""Priority, memory and garbage collector of the control loop's thread alone."""

import gc
import os
import re
import threading
from pathlib import Path
from unittest.mock import Mock

from renet.deploy import main, realtime


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
