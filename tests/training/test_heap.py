"""What is freed comes back without new pages."""

import subprocess
import sys

import pytest

from renet.training import heap
from renet.training.heap import keep_freed_memory

MEASURE = """
import resource, sys, torch
from renet.training.heap import keep_freed_memory
if "keep" in sys.argv and not keep_freed_memory():
    print("none")
    sys.exit()
def take():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    torch.ones(32 << 20)  # 128 MiB: 32,768 pages of 4 KiB.
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before
take()
print(take())
"""


def page_faults(*arguments: str) -> str:
    """Of taking 128 MiB for the second time, in a process of its own."""
    command = [sys.executable, "-c", MEASURE, *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def test_memory_taken_again_brings_no_page_faults():
    kept = page_faults("keep")
    if kept == "none":
        pytest.skip("the C library is not glibc")
    assert int(kept) < 100
    assert int(page_faults()) > 10 * (int(kept) + 1)


def test_without_glibc_nothing_is_changed(monkeypatch):
    monkeypatch.setattr(heap.ctypes, "CDLL", lambda name: object())
    assert not keep_freed_memory()
