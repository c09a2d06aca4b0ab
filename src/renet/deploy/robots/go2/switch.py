"""MotionSwitcher: which of the Go2's own controllers moves its motors, and how to stop it.

Topics, types and numbers of unitree_sdk2 (BSD-3).
"""

import itertools
import json
import math
import time
from collections import deque
from contextlib import suppress
from typing import Any

from cyclonedds.core import DDSException
from cyclonedds.idl import make_idl_struct, types

from renet.deploy.robots.go2.network import Network
from renet.deploy.robots.real.identity import Speakers

REQUESTS, RESPONSES = "rt/api/motion_switcher/request", "rt/api/motion_switcher/response"
CHECK_MODE, SELECT_MODE, RELEASE_MODE = 1001, 1002, 1003
CHECK_EVERY = 0.25
"""Seconds between two questions which mode is active, and between two releases."""
PATIENCE = 20
"""Questions whose answers count, however late they come."""


def _struct(name: str, **members: Any) -> Any:
    return make_idl_struct(name, f"unitree_api.msg.dds_.{name}", members)


Identity = _struct("RequestIdentity_", id=types.int64, api_id=types.int64)
Lease = _struct("RequestLease_", id=types.int64)
RequestPolicy = _struct("RequestPolicy_", priority=types.int32, noreply=bool)
RequestHeader = _struct("RequestHeader_", identity=Identity, lease=Lease, policy=RequestPolicy)
Status = _struct("ResponseStatus_", code=types.int32)
ResponseHeader = _struct("ResponseHeader_", identity=Identity, status=Status)
BINARY = types.sequence[types.uint8]
Request = _struct("Request_", header=RequestHeader, parameter=str, binary=BINARY)
Response = _struct("Response_", header=ResponseHeader, data=str, binary=BINARY)


class MotionSwitcher:
    """Asks for the active mode again and again, without ever waiting for the answer."""

    def __init__(self, network: Network) -> None:
        """Set up; nothing is asked yet."""
        self._writer = network.writer(REQUESTS, Request, depth=8)
        self._reader = network.reader(RESPONSES, Response, depth=8)
        self._numbers = itertools.count(time.time_ns())
        self._questions: deque[int] = deque(maxlen=PATIENCE)
        self._releases: deque[int] = deque(maxlen=PATIENCE)
        self._due = -math.inf
        self.speakers = Speakers()
        """Who has answered: one for each robot on the network."""
        self.mode: str | None = None
        """Name of the active mode, empty if there is none; None before the first answer."""
        self.released = False
        """Whether a release was carried out since the last step: the motors are limp from now."""

    def step(self, now: float, release: bool) -> None:
        """Take over an answer that has come, and ask again when that is due.

        Then `release` ends an active mode, too; `now` is in seconds on the caller's clock.
        """
        self.released = False
        for response in self._reader.take(8):
            self._read(response)
        if now < self._due:
            return
        self._due = now + CHECK_EVERY
        if release and self.mode:
            self._releases.append(self._ask(RELEASE_MODE))
        self._questions.append(self._ask(CHECK_MODE))

    @property
    def releasing(self) -> bool:
        """Whether a release was asked for: the motors may be limp from then on."""
        return bool(self._releases)

    def _ask(self, api: int, parameter: str = "{}") -> int:
        number = next(self._numbers)
        header = RequestHeader(Identity(number, api), Lease(0), RequestPolicy(0, False))
        with suppress(DDSException):  # A switch that does not acknowledge: it is asked again.
            self._writer.write(Request(header, parameter, []))
        return number

    def _read(self, response: Any) -> None:
        header = getattr(response, "header", None)  # Absent where a writer has left.
        if header is None or header.identity.id not in (*self._questions, *self._releases):
            return  # An answer to somebody else.
        if not self.speakers.hear(response.sample_info.publication_handle):
            return
        if header.status.code:
            return  # Of a switch that is busy.
        if header.identity.id in self._releases:
            self.released, self.mode = True, ""
            return
        try:
            self.mode = str(json.loads(response.data)["name"])
        except (ValueError, KeyError, TypeError):
            self.mode = "unknown"
