"""Work in chunks on several threads, and torch on one."""

from __future__ import annotations

import threading

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from renet.sim import threads
from renet.sim.threads import for_chunks, one_torch_thread


@given(st.integers(0, 300))
def test_every_row_is_visited_once(count: int):
    seen = []
    for_chunks(count, lambda first, last: seen.extend(range(first, last)))
    assert sorted(seen) == list(range(count))


def test_the_caller_works_too_and_others_help(monkeypatch):
    monkeypatch.setattr(threads, "THREADS", 2)
    meeting = threading.Barrier(2, timeout=20)
    met = set()

    def run(first: int, last: int) -> None:
        if first < 4:  # The first two chunks wait for each other: one thread alone never ends.
            meeting.wait()
            met.add(threading.get_ident())

    for_chunks(16, run)
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

    def run(first: int, last: int) -> None:
        if first >= 4:
            return
        both.wait()
        if (threading.get_ident() == caller) == fails_in_caller:
            raise ValueError("broken")
        ended.append(first)

    with pytest.raises(ValueError, match="broken"):
        for_chunks(16, run)
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
