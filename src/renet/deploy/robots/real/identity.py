"""Identity of a robot by its readings: one robot, its readings in order, and no restart."""

from collections.abc import Hashable

_COUNTS = 2**32
"""Number of values of a robot's 32-bit count of its readings, which goes on from zero."""
IN_A_ROW = 3
"""Number of readings that agree with each other, but not with those before, and are believed."""
MOST_ODD_COUNTS = 10
"""Number of counts that fit nowhere after which no reading is believed."""
_FORGET = 50
"""Number of counts that fit and make up for one that does not."""
RESTARTED = "the robot was started again, or another robot answers: end this program and begin anew"
CONFUSED = "the readings' counts make no sense: do several robots answer?"


class Speakers:
    """Writers to a topic, of which only one counts once it is pinned."""

    def __init__(self) -> None:
        self._heard: set[Hashable] = set()
        self._pinned = False

    def __len__(self) -> int:
        return len(self._heard)

    @property
    def intruded(self) -> bool:
        """True if another writer was heard after one was pinned."""
        return self._pinned and len(self._heard) > 1

    def hear(self, who: Hashable) -> bool:
        """Note a writer; returns True if it counts, as all do before one is pinned."""
        counts = not self._pinned or who == self._who
        self._heard.add(who)
        return counts

    def pin(self) -> None:
        """Let only the writer heard so far count; it must be exactly one."""
        (self._who,) = self._heard
        self._pinned = True


class Count:
    """The order of a robot's readings by their 32-bit count.

    A count that leaps is not believed at once: after a flipped bit, all later readings would be old
    ones for ever. If three in a row go on from there, readings in between were lost, or the robot
    was started again.
    """

    def __init__(self, leap: int) -> None:
        """Expect counts that are at most `leap` ahead of the last one, or late by as much."""
        self._leap = leap
        self._last: int | None = None
        self._strange: int | None = None
        self._run = 0
        self._odd = 0
        self._fits = 0
        self.problem = ""
        """Reason for which no further reading can be believed; empty while they can."""

    def news(self, count: int) -> bool:
        """Return True if a reading is newer than the last: not repeated, late or in doubt."""
        if self._last is None:
            self._last = count
            return True
        ahead = (count - self._last) % _COUNTS
        if ahead == 0 or _COUNTS - ahead <= self._leap:
            return False
        if ahead > self._leap and not self._goes_on(count, ahead):
            return False
        self._last = count
        self._strange = None
        self._fits += 1
        if self._fits % _FORGET == 0:
            self._odd = max(self._odd - 1, 0)
        return True

    def _goes_on(self, count: int, ahead: int) -> bool:
        """Return True if a count that leapt is one of several that go on from a leap ahead."""
        last = self._strange
        self._strange = count
        follows = last is not None and 0 < (count - last) % _COUNTS <= self._leap
        self._run = self._run + 1 if follows else 1
        self._odd += 1
        # Counts that go on from a leap back are those of a robot that counts anew.
        if self._run >= IN_A_ROW and ahead < _COUNTS // 2:
            return True
        if self._run >= IN_A_ROW:
            self.problem = RESTARTED
        elif self._odd > MOST_ODD_COUNTS:
            self.problem = CONFUSED
        return False
