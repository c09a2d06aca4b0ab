"""For all tests: interrupts work, and the garbage collector leaves alone what imports have made."""

import gc
import signal

import pytest

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
