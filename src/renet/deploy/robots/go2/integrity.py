"""Whether a Go2's messages arrive as they were sent."""

from typing import Any

from renet.deploy.robots.go2.messages import crc

ENOUGH = 10
"""Messages from which it is known whether a robot's checksums are right."""
MOST_DAMAGED = 50
"""Damaged messages in a row, 0.1 s, after which a robot is given up."""


class Integrity:
    """Checks the CRC of messages, if the robot's are right at all.

    The vendor's own programs do not look at it, and what every firmware writes there is not known.
    So the first messages tell; none of them moves a motor.
    """

    def __init__(self) -> None:
        self._right = self._seen = self._damaged = 0
        self._checks: bool | None = None
        self.problem = ""
        """Why the robot cannot be understood; empty while it can."""

    def intact(self, sample: Any) -> bool:
        """Whether a message may be believed."""
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
        """Decide by the messages so far whether the next ones are checked."""
        self._checks = self._seen >= ENOUGH and self._right >= 0.9 * self._seen
