"""Work on several threads, and torch on one."""

import threading
from contextlib import nullcontext
from functools import partial

import pytest
import torch

from renet.sim import threads
from renet.sim.threads import on_all_threads, one_torch_thread


@pytest.mark.parametrize("fails", ["nowhere", "in the caller", "elsewhere"])
def test_errors_are_raised_after_all_stop(monkeypatch, fails):
    monkeypatch.setattr(threads, "THREADS", 2)
    caller, ended = threading.get_ident(), []
    meeting = threading.Barrier(2, timeout=20)  # One thread alone never ends.

    def work() -> None:
        meeting.wait()
        here = "in the caller" if threading.get_ident() == caller else "elsewhere"
        if here == fails:
            raise ValueError("broken")
        ended.append(here)

    with nullcontext() if fails == "nowhere" else pytest.raises(ValueError, match="broken"):
        on_all_threads(work)
    assert {*ended} == {"in the caller", "elsewhere"} - {fails}


def test_torch_gets_its_threads_back(request):
    request.addfinalizer(partial(torch.set_num_threads, torch.get_num_threads()))
    torch.set_num_threads(2)
    with one_torch_thread("cpu"):
        assert torch.get_num_threads() == 1
    assert torch.get_num_threads() == 2
    with one_torch_thread("cuda:0"):
        assert torch.get_num_threads() == 2
