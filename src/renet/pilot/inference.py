"""Where the 10 Hz tick runs: in line, or on a second thread that the control loop never waits for.

The loop gives the thread a few milliseconds, in which it is usually done: then a live robot acts
on exactly what training acted on. A result that is late is used one or more control steps later; a
tick that failed or is stuck at the next one costs vision, not the robot: that next tick runs in
line, blind, and the selector falls back to OP.
"""

import threading
import time
from concurrent.futures import CancelledError, Future
from queue import SimpleQueue

from renet.pilot.tick import EstimatorInput, EstimatorOutput, Sessions, infer


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
        output = self._output
        self._output = None
        return output

    def close(self) -> None:
        """Stop; safe to call twice."""


class ThreadedInference(InlineInference):
    """Ticks on a daemon thread, which survives those that fail."""

    patience = 0.008
    """Seconds that `take` waits in the step that began a tick."""

    def __init__(self, sessions: Sessions) -> None:
        super().__init__(sessions)
        self._deadline = 0.0
        self._jobs: SimpleQueue[tuple[EstimatorInput, Future[EstimatorOutput]] | None]
        self._jobs = SimpleQueue()
        self._tick: Future[EstimatorOutput] | None = None
        """The newest tick, as long as its result was not taken."""
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def ready(self) -> bool:
        """False if the last tick failed or was late: the policy goes on without its result."""
        if self._tick is None:
            return True
        # A result that nobody took is late even if it is here by now, unless the tick that it was
        # for has been made up for already.
        late = self._deadline > 0.0
        self._deadline = 0.0
        done = self._tick.done()
        if done:
            self._tick = None
        return done and not late

    def begin(self, inputs: EstimatorInput) -> None:
        """Start a tick."""
        self._tick = Future()
        self._deadline = time.monotonic() + self.patience
        self._jobs.put((inputs, self._tick))

    def take(self) -> EstimatorOutput | None:
        """The tick's result, once, or None; waits at most for the rest of `patience`."""
        if self._tick is None or self._deadline == 0.0:
            return None
        try:
            output = self._tick.result(max(self._deadline - time.monotonic(), 0.0))
        except (TimeoutError, CancelledError):  # `ready` says so before the next tick.
            return None
        self._tick = None
        return output

    def close(self) -> None:
        """Stop the thread."""
        self._jobs.put(None)
        self._thread.join(timeout=1.0)

    def _work(self) -> None:
        while (job := self._jobs.get()) is not None:
            inputs, tick = job
            try:
                tick.set_result(infer(self._sessions, inputs))
            except BaseException:  # To have no result is its report.
                tick.cancel()
