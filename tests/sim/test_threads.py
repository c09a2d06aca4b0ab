"""Work on several threads, and torch on one."""

import threading

import pytest
import torch

from renet.sim import threads
from renet.sim.threads import on_all_threads, one_torch_thread


def test_the_caller_works_too_and_others_help(monkeypatch):
    monkeypatch.setattr(threads, "THREADS", 2)
    meeting = threading.Barrier(2, timeout=20)  # One thread alone never ends.
    met = set()

    def work() -> None:
        meeting.wait()
        met.add(threading.get_ident())

    on_all_threads(work)
    assert len(met) == 2
    assert threading.get_ident() in met


@pytest.mark.parametrize("fails_in_caller", [True, False])
def test_what_goes_wrong_in_any_thread_is_raised_after_all_have_stopped(
    monkeypatch, fails_in_caller: bool
):
    monkeypatch.setattr(threads, "THREADS", 2)
    caller = threading.get_ident()
    both = threading.Barrier(2, timeout=20)
    ended = []

    def work() -> None:
        both.wait()
        if (threading.get_ident() == caller) == fails_in_caller:
            raise ValueError("broken")
        ended.append(threading.get_ident())

    with pytest.raises(ValueError, match="broken"):
        on_all_threads(work)
    assert len(ended) == 1


def test_torch_gets_its_threads_back():
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(2)
        with one_torch_thread("cpu"):
            assert torch.get_num_threads() == 1
        assert torch.get_num_threads() == 2
        with one_torch_thread("cuda:0"):
            assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)
