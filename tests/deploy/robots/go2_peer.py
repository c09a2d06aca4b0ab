"""The fake Go2 in the hands of a test: it remembers what it was told, and can fail."""

import time
from types import SimpleNamespace
from typing import Any

import numpy as np

from renet.deploy.robots.go2.fake import FakeGo2
from renet.deploy.robots.go2.link import COMMAND_TOPIC, LEG_MOTORS, Go2Link
from renet.deploy.robots.go2.messages import LowCmd
from renet.deploy.robots.real.braking import PERIOD

from ..dds.domain import free_domain
from . import peer

BUSY = 7002
"""What MotionSwitcher says instead of ending a mode, now and then."""
PARTS = ("mode", "q", "dq", "tau", "kp", "kd")


class Peer(peer.Peer, FakeGo2):
    """A Go2 in a domain of its own."""

    SERVO = 1

    def __init__(self) -> None:
        peer.Peer.__init__(self)
        FakeGo2.__init__(self, free_domain())
        self._commands = self.network.reader(COMMAND_TOPIC, LowCmd, depth=10_000)
        self.driver = "renet.deploy.robots.go2.driver:go2_robot", ("lo", free_domain())
        self.slow = 0
        """Steps by which MotionSwitcher's answers are late."""
        self._answers: list[tuple[int, Any]] = []
        self._switch, self._responses = self._responses, SimpleNamespace(write=self._delay)
        self.silent = self.deaf = self.stubborn = self.still = False

    def make_link(self, watch: bool = False) -> Go2Link:
        """Both are in this process, and messages pass at once."""
        return Go2Link("lo", free_domain(), watch)

    def live(self) -> None:
        self.step()
        time.sleep(PERIOD)

    def receive(self, sample) -> None:
        accepted = self.accepted
        super().receive(sample)
        if self.accepted > accepted:
            motors = sample.values["motor_cmd"][LEG_MOTORS]
            self.commands.append(np.stack([motors[part].astype(float) for part in PARTS], axis=1))
            self.arrivals.append(sample.sample_info.source_timestamp)

    def answer(self) -> None:
        if not self.deaf:
            super().answer()
        while self._answers and self._answers[0][0] <= self.steps:
            self._switch.write(self._answers.pop(0)[1])

    def _delay(self, response: Any) -> None:
        self._answers.append((self.steps + self.slow, response))

    def release(self) -> int:
        return BUSY if self.stubborn else super().release()

    def publish(self) -> None:
        if not self.silent:
            super().publish()

    def close(self) -> None:
        """Leave the network: whatever speaks to it goes when it is forgotten."""
        vars(self).clear()
