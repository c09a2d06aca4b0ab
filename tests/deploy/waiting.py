"""Waiting for other threads without asserting on the clock."""

import time
from collections.abc import Callable

import pytest


def until(condition: Callable[[], bool], act: Callable[[], None] = lambda: None) -> None:
    """Act until a condition holds; gives up after about ten seconds."""
    for _ in range(1000):
        if condition():
            return
        act()
        time.sleep(0.01)
    pytest.fail("it never happened")
