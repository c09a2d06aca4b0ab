"""Client of MotionSwitcher, the Go2's service that starts and ends its own controllers.

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

from renet.deploy.dds.network import Network
from renet.deploy.robots.real.identity import Speakers

REQUESTS = "rt/api/motion_switcher/request"
RESPONSES = "rt/api/motion_switcher/response"
CHECK_MODE = 1001
"""Request for the name of the active mode."""
SELECT_MODE = 1002
"""Request to start a mode."""
RELEASE_MODE = 1003
"""Request to end the active mode."""
CHECK_EVERY = 0.25
"""Time from one question for the active mode to the next, and from release to release, s."""
_PATIENCE = 20
"""Number of last questions whose answers count, however late they come."""


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
        """Join the topics; nothing is asked yet."""
        self._writer = network.writer(REQUESTS, Request, depth=8)
        self._reader = network.reader(RESPONSES, Response, depth=8)
        self._numbers = itertools.count(time.time_ns())
        self._questions: deque[int] = deque(maxlen=_PATIENCE)
        self._releases: deque[int] = deque(maxlen=_PATIENCE)
        self._due = -math.inf
        self.speakers = Speakers()
        """Services that have answered: one for each robot on the network."""
        self.mode: str | None = None
        """Name of the active mode, empty if there is none; None before the first answer."""
        self.released = False
        """True if a release was carried out since the last step: the motors are limp from now."""

    def step(self, now: float, release: bool) -> None:
        """Take over the answers that have come, and ask again when that is due.

        Args:
            now: Time on the caller's clock, s.
            release: Ask also for the end of an active mode.
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
        """True once a release was asked for; from then on the motors may be limp."""
        return bool(self._releases)

    def _ask(self, api: int, parameter: str = "{}") -> int:
        number = next(self._numbers)
        header = RequestHeader(Identity(number, api), Lease(0), RequestPolicy(0, False))
        # A switch that does not acknowledge is asked again later.
        with suppress(DDSException):
            self._writer.write(Request(header, parameter, []))
        return number

    def _read(self, response: Any) -> None:
        """Take over an answer, unless it is somebody else's."""
        # Absent when a writer has left.
        header = getattr(response, "header", None)
        if header is None or header.identity.id not in (*self._questions, *self._releases):
            return
        if not self.speakers.hear(response.sample_info.publication_handle):
            return
        # A busy switch answers with an error.
        if header.status.code:
            return
        if header.identity.id in self._releases:
            self.released = True
            self.mode = ""
            return
        try:
            self.mode = str(json.loads(response.data)["name"])
        except (ValueError, KeyError, TypeError):
            self.mode = "unknown"
