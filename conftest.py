"""For all tests: few threads, working interrupts, quick garbage collection, tries in real time."""

import gc
import os
import signal
from collections.abc import Iterator

import pytest

# Workers share the cores: OpenMP's threads must neither be many nor wait in a loop.
os.environ |= {"OMP_NUM_THREADS": "1", "OMP_WAIT_POLICY": "passive"}

# What is imported while tests are collected stays, and need not be looked through.
gc.disable()

# A shell's background jobs ignore SIGINT, and so would each program that a test interrupts.
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="module", autouse=True)
def frozen_imports() -> None:
    """Every environment that is built collects garbage, which among a million objects takes long.

    A control loop on a robot thaws them at its end.
    """
    if not gc.get_freeze_count():
        gc.collect()
        gc.freeze()


@pytest.fixture
def two_threads() -> Iterator[None]:
    """Two threads of torch, so that policy and estimators learn at the same time."""
    # Most tests need no torch, which takes seconds to load.
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)


def pytest_collection_finish() -> None:
    """Tests leave garbage."""
    gc.enable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Give tests that live on the wall clock three tries, for a busy computer may be too late.

    What is wrong in the code fails all three.
    """
    for item in items:
        if item.get_closest_marker("wall_clock"):
            item.add_marker(pytest.mark.flaky(reruns=2))
