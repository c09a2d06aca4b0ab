"""Marks of the tests."""

import pytest


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Give tests that live on the wall clock three tries, for a busy computer may be too late.

    What is wrong in the code fails all three.
    """
    for item in items:
        if item.get_closest_marker("wall_clock"):
            item.add_marker(pytest.mark.flaky(reruns=2))
