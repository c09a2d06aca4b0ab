"""Words for the terminal, said by a thread: a terminal that stalls must not stall a robot."""

from __future__ import annotations

import threading
from queue import SimpleQueue


class Speaker:
    """Prints lines in order, later."""

    def __init__(self) -> None:
        self._lines: SimpleQueue[str | None] = SimpleQueue()
        self._thread = threading.Thread(target=self._speak, daemon=True)
        self._thread.start()

    def say(self, line: str) -> None:
        """Print a line soon."""
        self._lines.put(line)

    def close(self) -> None:
        """Say what is left; give up on a terminal that takes nothing."""
        self._lines.put(None)
        self._thread.join(timeout=1.0)

    def _speak(self) -> None:
        while (line := self._lines.get()) is not None:
            try:
                print(line, flush=True)
            except OSError:  # The terminal is gone.
                return
