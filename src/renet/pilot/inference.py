"""Inference of the 10 Hz tick, in line or on a second thread.

The control loop waits a few milliseconds for the thread, which is usually done by then: the robot
then acts on the same estimates as in training. A late result is used one or more control steps
later. If a tick has failed, or is not done when the next one is due, the robot loses vision but
walks on: the next tick runs in line without an image, and the selector falls back to OP.
"""

import threading
import time
from concurrent.futures import CancelledError, Future
from queue import SimpleQueue

from renet.pilot.tick import EstimatorInput, EstimatorOutput, Sessions, infer


class InlineInference:
    """Inference on the calling thread, with the same result in every run."""

    def __init__(self, sessions: Sessions) -> None:
        self._sessions = sessions
        self._output: EstimatorOutput | None = None

    def ready(self) -> bool:
        """Return True if `begin` may be called; called once at each tick."""
        return True

    def begin(self, inputs: EstimatorInput) -> None:
        """Run a tick."""
        self._output = infer(self._sessions, inputs)

    def take(self) -> EstimatorOutput | None:
        """Return the tick's result once; None if there is none yet."""
        output = self._output
        self._output = None
        return output

    def reset(self) -> None:
        """Drop the result of a tick of the past: it is never taken."""
        self._output = None

    def close(self) -> None:
        """Stop inference; safe to call twice."""


class ThreadedInference(InlineInference):
    """Inference on a daemon thread, which survives ticks that fail."""

    patience = 0.008
    """Longest time that `take` waits in the step that began a tick, s."""

    def __init__(self, sessions: Sessions) -> None:
        super().__init__(sessions)
        self._deadline = 0.0
        self._jobs: SimpleQueue[tuple[EstimatorInput, Future[EstimatorOutput]] | None]
        self._jobs = SimpleQueue()
        self._tick: Future[EstimatorOutput] | None = None
        """Newest tick, until its result is taken."""
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def ready(self) -> bool:
        """Return False if the last tick failed or was late: the policy continues without it."""
        if self._tick is None:
            return True
        # A result that was not taken in time is late, even if it is here by now. The deadline is
        # zero if a tick in line has replaced it already, or after a reset.
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
        """Return the tick's result once, or None; waits for at most the rest of `patience`."""
        if self._tick is None or self._deadline == 0.0:
            return None
        try:
            output = self._tick.result(max(self._deadline - time.monotonic(), 0.0))
        except (TimeoutError, CancelledError):
            # `ready` reports this before the next tick.
            return None
        self._tick = None
        return output

    def reset(self) -> None:
        """Drop the result of a tick of the past: it is never taken, and not late once it is done.

        As long as it is not done, `ready` returns False.
        """
        self._deadline = 0.0

    def close(self) -> None:
        """Stop the thread."""
        self._jobs.put(None)
        self._thread.join(timeout=1.0)

    def _work(self) -> None:
        """Run ticks until `close` ends the thread."""
        while (job := self._jobs.get()) is not None:
            inputs, tick = job
            try:
                tick.set_result(infer(self._sessions, inputs))
            except BaseException:
                # `take` and `ready` find a tick without a result.
                tick.cancel()
