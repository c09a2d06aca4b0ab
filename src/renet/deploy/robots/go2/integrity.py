"""Integrity of a Go2's messages: their checksums."""

from typing import Any

from renet.deploy.robots.go2.messages import crc

_ENOUGH = 10
"""Number of messages that decide if a robot's checksums are right at all."""
MOST_DAMAGED = 50
"""Number of damaged messages in a row, 0.1 s, after which a robot is given up."""


class Integrity:
    """Checks the CRC of messages, if the robot's are right at all.

    The vendor's own programs do not look at it, and it is not known if every firmware writes it
    right. So the first messages, which move no motor, decide.
    """

    def __init__(self) -> None:
        self._right = self._seen = self._damaged = 0
        self._checks: bool | None = None
        self.problem = ""
        """Reason for which the robot cannot be understood; empty while it can."""

    def intact(self, sample: Any) -> bool:
        """Return True if a message may be believed."""
        if self._checks is False:
            return True
        right = int(sample.values["crc"]) == crc(sample.raw)
        if self._checks is None:
            self._seen += 1
            self._right += right
            return True
        self._damaged = 0 if right else self._damaged + 1
        if self._damaged > MOST_DAMAGED:
            self.problem = "the robot's messages arrive damaged: check cable and network card"
        return right

    def settle(self) -> None:
        """Decide by the messages so far if the next ones are checked."""
        self._checks = self._seen >= _ENOUGH and self._right >= 0.9 * self._seen
