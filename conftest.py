"""For all tests: the garbage collector leaves alone what imports have made."""

import gc

import pytest


@pytest.fixture(scope="module", autouse=True)
def frozen_imports() -> None:
    """Every environment that is built collects garbage, which among a million objects takes long.

    A control loop on a robot thaws them at its end.
    """
    if not gc.get_freeze_count():
        gc.collect()
        gc.freeze()
