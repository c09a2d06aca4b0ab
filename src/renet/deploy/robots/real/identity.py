"""Whose readings arrive: those of one robot, in their order, from one start of it to the next."""

from collections.abc import Hashable

COUNTS = 2**32
"""A robot's count of its readings goes on from zero."""
IN_A_ROW = 3
"""Readings that agree with each other, but not with those before, that are no mistake."""
MOST_ODD = 10
"""Counts that fit nowhere, less one for each `FORGET` that fit, that are no mistake either."""
FORGET = 50
RESTARTED = "the robot was started again, or another robot answers: end this program and begin anew"
CONFUSED = "the readings' counts make no sense: do several robots answer?"


class Speakers:
    """Who writes to a topic; pinned, only one of them counts."""

    def __init__(self) -> None:
        self._heard: set[Hashable] = set()
        self._pinned = False

    def __len__(self) -> int:
        return len(self._heard)

    @property
    def intruded(self) -> bool:
        """Whether another one was heard after the first had been pinned."""
        return self._pinned and len(self._heard) > 1

    def hear(self, who: Hashable) -> bool:
        """Hear one; returns whether it counts: all do before one is pinned."""
        counts = not self._pinned or who == self._who
        self._heard.add(who)
        return counts

    def pin(self) -> None:
        """Let only the one that was heard so far count; it must be exactly one."""
        (self._who,) = self._heard
        self._pinned = True


class Count:
    """The order of a robot's readings by their 32-bit count.

    A count that leaps is not believed at once: a flipped bit would make all later readings old ones
    for ever. When three in a row go on from there, readings in between were lost, or the robot was
    started again.
    """

    def __init__(self, leap: int) -> None:
        """`leap` is the most by which one count may be ahead of the last, or late."""
        self._leap = leap
        self._last: int | None = None
        self._strange: int | None = None
        self._run = 0
        self._odd = self._fits = 0
        self.problem = ""
        """Why no further reading can be believed; empty while they can."""

    def news(self, count: int) -> bool:
        """Whether a reading is newer than the last: not repeated, out of order, or in doubt."""
        if self._last is None:
            self._last = count
            return True
        ahead = (count - self._last) % COUNTS
        if ahead == 0 or COUNTS - ahead <= self._leap:
            return False
        if ahead > self._leap and not self._goes_on(count, ahead):
            return False
        self._last = count
        self._strange = None
        self._fits += 1
        if self._fits % FORGET == 0:
            self._odd = max(self._odd - 1, 0)
        return True

    def _goes_on(self, count: int, ahead: int) -> bool:
        """Whether a count that leapt is one of several that go on from a leap ahead."""
        last, self._strange = self._strange, count
        follows = last is not None and 0 < (count - last) % COUNTS <= self._leap
        self._run = self._run + 1 if follows else 1
        self._odd += 1
        if self._run >= IN_A_ROW and ahead < COUNTS // 2:
            return True
        if self._run >= IN_A_ROW:
            self.problem = RESTARTED
        elif self._odd > MOST_ODD:
            self.problem = CONFUSED
        return False
