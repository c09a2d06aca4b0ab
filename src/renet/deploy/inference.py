"""Where the 10 Hz tick runs: in line, or on a second thread that the control loop never waits for.

The loop gives the thread a few milliseconds, in which it is usually done: then a live robot acts
on exactly what training acted on. A result that is late is used one or more control steps later; a
thread that is dead or stuck at the next tick costs vision, not the robot: that tick runs in line,
blind, and the selector falls back to OP.
"""

import threading
import time
from queue import Empty, SimpleQueue

import onnxruntime as ort

from renet.bundle.policy import EstimatorInput, EstimatorOutput, infer

Sessions = dict[str, ort.InferenceSession]


class InlineInference:
    """Every tick is done when it was begun: the same result in every run."""

    def __init__(self, sessions: Sessions) -> None:
        self._sessions = sessions
        self._output: EstimatorOutput | None = None

    def ready(self) -> bool:
        """Whether `begin` may be called; called once at every tick."""
        return True

    def begin(self, inputs: EstimatorInput) -> None:
        """Start a tick."""
        self._output = infer(self._sessions, inputs)

    def take(self) -> EstimatorOutput | None:
        """The tick's result, once; None if there is none yet."""
        output, self._output = self._output, None
        return output

    def close(self) -> None:
        """Stop; safe to call twice."""


class ThreadedInference(InlineInference):
    """Ticks on a daemon thread; a dead thread is replaced at the next tick."""

    def __init__(self, sessions: Sessions, patience: float = 0.008) -> None:
        """Start the thread; `take` waits `patience` seconds in the step that began a tick."""
        super().__init__(sessions)
        self._patience = patience
        self._start()

    def _start(self) -> None:
        self._jobs: SimpleQueue[EstimatorInput | None] = SimpleQueue()
        self._results: SimpleQueue[EstimatorOutput] = SimpleQueue()
        self._outstanding, self._deadline = False, 0.0
        self._thread = threading.Thread(
            target=_work, args=(self._sessions, self._jobs, self._results), daemon=True
        )
        self._thread.start()

    def ready(self) -> bool:
        """False if the thread died, which starts another, or was too late with the last tick.

        Its result, when it comes, is thrown away: the policy goes on without it.
        """
        if not self._thread.is_alive():
            self._start()
            return False
        if self._outstanding:
            # A result that nobody took is late even if it is here by now, unless the tick that it
            # was for has been made up for already.
            late, self._deadline = self._deadline > 0.0, 0.0
            return self._collect(0.0) is not None and not late
        return True

    def begin(self, inputs: EstimatorInput) -> None:
        """Start a tick."""
        self._outstanding, self._deadline = True, time.monotonic() + self._patience
        self._jobs.put(inputs)

    def take(self) -> EstimatorOutput | None:
        """The tick's result, once, or None; waits at most for the rest of `patience`."""
        if not self._outstanding or self._deadline == 0.0:
            return None
        return self._collect(max(self._deadline - time.monotonic(), 0.0))

    def _collect(self, wait: float) -> EstimatorOutput | None:
        try:
            output = self._results.get(timeout=wait) if wait > 0 else self._results.get_nowait()
        except Empty:
            return None
        self._outstanding = False
        return output

    def close(self) -> None:
        """Stop the thread."""
        self._jobs.put(None)
        self._thread.join(timeout=1.0)


def _work(
    sessions: Sessions,
    jobs: SimpleQueue[EstimatorInput | None],
    results: SimpleQueue[EstimatorOutput],
) -> None:
    while (inputs := jobs.get()) is not None:
        try:
            results.put(infer(sessions, inputs))
        except Exception:
            # The thread's end is its report: the control loop sees it at the next tick.
            return
