"""What ends a run from outside its control loop: signals, and a loop that hangs."""

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType

ENDS = ("INT", "TSTP", "QUIT", "TERM", "HUP", "USR1", "USR2")
"""Signals that end a run. TSTP, Ctrl-Z, too: a stopped program could not brake."""
POLL = 0.1
"""Seconds between two looks at the loop."""
PATIENCE = 6.0
"""Seconds without a step after which the loop hangs; a recorder waits 5 s for a slow disk."""
CLOSING = 20.0
"""Seconds that devices may take to be closed by a run that hangs."""
HANGS = "the control loop hangs"
EXIT_CODE = 2


@contextmanager
def interruptible() -> Iterator[Callable[[], bool]]:
    """Let signals ask a run to end, braking, instead of ending the program.

    Yields a function that says whether the run was asked to; a second Ctrl-C interrupts.
    """
    interrupted = False

    def ask(number: int, frame: FrameType | None) -> None:
        nonlocal interrupted
        if interrupted and number == signal.SIGINT:
            raise KeyboardInterrupt
        interrupted = True

    signals = [signal.Signals[f"SIG{name}"] for name in ENDS]
    before = [signal.signal(number, ask) for number in signals]
    try:
        yield lambda: interrupted
    finally:
        for number, handler in zip(signals, before, strict=True):
            signal.signal(number, handler)


@contextmanager
def watchdog(close: Callable[[], None]) -> Iterator[Callable[[], None]]:
    """End this process when a loop hangs, as in a model or a driver that does not return.

    Python handles no signal meanwhile: neither Ctrl-C nor TERM would end it. Before the process
    ends, `close` brakes and saves what there is, on another thread. Yields a function to call at
    every step.
    """
    steps, hangs, ended = 0, False, threading.Event()

    def step() -> None:
        nonlocal steps
        steps += 1
        if hangs:
            thread.join()  # Until the process ends: a loop that returns late must not walk on.

    def watch() -> None:
        nonlocal hangs
        last = looks = 0
        while not ended.wait(POLL):
            # Looks are counted, not seconds: a computer that slept has not looked.
            last, looks = steps, looks + 1 if steps == last else 0
            if hangs := looks * POLL >= PATIENCE:
                _end(close)

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield step
    finally:
        ended.set()
        thread.join()


def _end(close: Callable[[], None]) -> None:
    """End the process, whatever hangs."""
    threading.Timer(CLOSING, os._exit, [EXIT_CODE]).start()
    with suppress(Exception):
        close()
    with suppress(Exception):  # The terminal may hang, too, or be none.
        sys.stderr.write(f"renet: {HANGS} since {PATIENCE:g} s: the run ends, braked\n")
        sys.stderr.flush()
    os._exit(EXIT_CODE)
