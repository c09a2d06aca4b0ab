"""What is freed comes back without new pages."""

import subprocess
import sys

import pytest

from renet.training import heap
from renet.training.heap import keep_freed_memory

MEASURE = """
import resource, runpy, sys
keep_freed_memory = runpy.run_path(sys.argv[1])["keep_freed_memory"]
if "keep" in sys.argv and not keep_freed_memory():
    print("none")
    sys.exit()
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(10):
    b"x" * (64 << 20)  # 16,384 pages of 4 KiB.
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


def page_faults(*arguments: str) -> str:
    """Of taking and freeing as much ten times, in a process of its own."""
    command = [sys.executable, "-c", MEASURE, heap.__file__, *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def test_memory_taken_again_brings_few_page_faults():
    kept = page_faults("keep")
    if kept == "none":
        pytest.skip("the C library is not glibc")
    # Something small may lie in the way the second time, so that the heap grows once more.
    assert 3 * int(kept) < int(page_faults())


def test_without_glibc_nothing_is_changed(monkeypatch):
    monkeypatch.setattr(heap.ctypes, "CDLL", lambda name: object())
    assert not keep_freed_memory()
