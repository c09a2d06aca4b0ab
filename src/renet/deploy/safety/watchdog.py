"""Ends of a run from outside its control loop: signals, and a watchdog for a loop that hangs."""

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType

_SIGNALS = ("INT", "TSTP", "QUIT", "TERM", "HUP", "USR1", "USR2")
"""Signals that end a run; also TSTP (Ctrl-Z), since a stopped program could not brake."""
_POLL = 0.1
"""Period at which the watchdog looks at the loop, s."""
HANG_SECONDS = 6.0
"""Time without a step, s, after which the loop hangs; a recorder waits 5 s for a slow disk."""
CLOSE_SECONDS = 20.0
"""Time that a run that hangs gives its devices to close, s."""
HANGS = "the control loop hangs"
"""Message of a run that hangs."""
_EXIT_CODE = 2


@contextmanager
def interruptible() -> Iterator[Callable[[], bool]]:
    """Let signals ask a run to brake and end, instead of ending the program.

    Yields a function that returns True once the run was asked to end; a second Ctrl-C raises
    KeyboardInterrupt.
    """
    interrupted = False

    def ask(number: int, frame: FrameType | None) -> None:
        nonlocal interrupted
        if interrupted and number == signal.SIGINT:
            raise KeyboardInterrupt
        interrupted = True

    signals = [signal.Signals[f"SIG{name}"] for name in _SIGNALS]
    before = [signal.signal(number, ask) for number in signals]
    try:
        yield lambda: interrupted
    finally:
        for number, handler in zip(signals, before, strict=True):
            signal.signal(number, handler)


@contextmanager
def watchdog(close: Callable[[], None]) -> Iterator[Callable[[], None]]:
    """End this process when its loop hangs, as in a model or a driver that does not return.

    Meanwhile Python handles no signals: neither Ctrl-C nor TERM would end the process. Before it
    ends, `close` brakes the robot and saves the recording, on another thread. Yields a function to
    call at every step.
    """
    steps = 0
    hangs = False
    ended = threading.Event()

    def step() -> None:
        nonlocal steps
        steps += 1
        # A loop that returns late must not walk on: it waits until the process ends.
        if hangs:
            thread.join()

    def watch() -> None:
        nonlocal hangs
        last = 0
        looks = 0
        while not ended.wait(_POLL):
            # Looks are counted, not seconds: a computer that slept has not looked.
            seen = steps
            looks = looks + 1 if seen == last else 0
            last = seen
            hangs = looks * _POLL >= HANG_SECONDS
            if hangs:
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
    # Ends it even if closing the devices hangs, too.
    threading.Timer(CLOSE_SECONDS, os._exit, [_EXIT_CODE]).start()
    with suppress(Exception):
        close()
    # The terminal may be gone.
    with suppress(Exception):
        sys.stderr.write(f"renet: {HANGS} since {HANG_SECONDS:g} s: the run ends, braked\n")
        sys.stderr.flush()
    os._exit(_EXIT_CODE)
