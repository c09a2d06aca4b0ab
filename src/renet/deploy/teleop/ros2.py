"""Velocities from a ROS 2 topic, read through Cyclone DDS; ROS itself is not needed.

ROS 2's topics are DDS topics by other names: `cmd_vel` is `rt/cmd_vel`, and the type of
`geometry_msgs/msg/Twist` is `geometry_msgs::msg::dds_::Twist_`. DDS connects only readers and
writers of one type, so that a topic that may carry `Twist` or `TwistStamped` needs two readers.
"""

import math
import os
import re
from dataclasses import replace
from typing import Any

import numpy as np
from cyclonedds.idl import make_idl_struct, types

from renet.deploy.cdr import ENCAPSULATION
from renet.deploy.dds.messages import message_type, parse_fields
from renet.deploy.dds.network import Network
from renet.deploy.teleop.base import Teleop, TeleopCommand, Velocity
from renet.errors import RenetError

TWIST = parse_fields("Vector3_ linear, Vector3_ angular", Vector3_=parse_fields("f8 x, f8 y, f8 z"))
Twist = message_type("Twist_", TWIST, "geometry_msgs.msg.dds_")
"""Velocity: linear in m/s, angular in rad/s, x ahead, y left, z up."""
Time = make_idl_struct(
    "Time_", "builtin_interfaces.msg.dds_.Time_", {"sec": types.int32, "nanosec": types.uint32}
)
StdHeader = make_idl_struct(
    "Header_", "std_msgs.msg.dds_.Header_", {"stamp": Time, "frame_id": str}
)
TwistStamped: Any = make_idl_struct(
    "TwistStamped_", "geometry_msgs.msg.dds_.TwistStamped_", {"header": StdHeader, "twist": Twist}
)
"""Velocity with a header. Its samples are those of `Twist`: the stamp is by a clock that need not
be this computer's, and the frame is taken to be the base."""
STAMP_SIZE = 8
"""Bytes of a header's time."""
TOPIC = re.compile(r"/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
"""Pattern of topic names of ROS 2, without names that ROS itself would expand."""
LAST_DOMAIN = 232
"""Highest DDS domain, as the ports of higher ones do not exist."""
COUNT_EVERY = 1.0
"""Time from one count of the publishers to the next, s."""


def _twist_of(data: bytes, *arguments: Any, **options: Any) -> Any:
    """Return the sample of `Twist` in the payload of a `TwistStamped`.

    Its `values` are None if the payload is of another type or encoding, as those of `Twist`.
    """
    body = data[len(ENCAPSULATION) :]
    # After the time come the size of the frame's name and the name; numbers of eight bytes begin
    # at multiples of eight.
    name = STAMP_SIZE + 4
    end = name + int.from_bytes(body[STAMP_SIZE:name], "little")
    start = end + -end % 8
    return Twist.deserialize(data[: len(ENCAPSULATION)] + body[start:])


TwistStamped.deserialize = staticmethod(_twist_of)
TwistStamped.deserialize_key = staticmethod(Twist.deserialize_key)


def domain_of(given: int | None) -> int:
    """Return the DDS domain to join: the given one, or that of the variable ROS_DOMAIN_ID.

    Raises:
        RenetError: It is no number from 0 to 232.
    """
    text = os.environ.get("ROS_DOMAIN_ID") or "0"
    source = "ROS_DOMAIN_ID" if given is None else "--ros-domain"
    value = text if given is None else str(given)
    # `isdigit` alone accepts the digits of other scripts, too.
    if not (value.isascii() and value.isdigit() and int(value) <= LAST_DOMAIN):
        raise RenetError(f"{source} must be from 0 to {LAST_DOMAIN}, got {value}")
    return int(value)


class Ros2Teleop:
    """Takes velocities from the newest message on a topic; without messages, the robot stands.

    A message carries no wish to stand up or to stop; those come from the keyboard.
    """

    def __init__(
        self,
        topic: str,
        domain: int,
        interface: str,
        silence: float,
        keys: Teleop | None,
        rises: bool,
    ) -> None:
        """Subscribe to a topic of a DDS domain.

        Args:
            topic: Name of the topic in ROS 2, such as cmd_vel.
            domain: DDS domain.
            interface: Network card; if empty, Cyclone DDS chooses, as it does for ROS 2.
            silence: Time without a message after which the robot stands, s.
            keys: Keyboard that arms, stops and quits; None without one.
            rises: Arm the robot at once.

        Raises:
            RenetError: There is no such interface, or DDS fails.
        """
        self._topic = topic
        network = Network(interface, domain)
        name = f"rt/{topic.removeprefix('/')}"
        self._readers = (network.reader(name, Twist), network.reader(name, TwistStamped))
        self._keys = keys
        self._silence = silence
        self._velocity = Velocity()
        self._heard = -math.inf
        self._counted = -math.inf
        self._publishers = 0
        self._malformed = False
        self._rises = rises
        self.attended = keys is not None
        ends = "r stand up and walk, space brake, q quit" if keys else "Ctrl-C quits"
        self.controls = f"velocities of {topic} in domain {domain}, {ends}"
        self.problem = ""
        """Problem that the operator is to be told; empty if there is none."""

    @property
    def quit(self) -> bool:
        """True if the run is to end."""
        return getattr(self._keys, "quit", False)

    def command(self, now: float) -> TeleopCommand:
        """Return the newest velocity, with the keyboard's wishes to arm and to stop."""
        self._listen(now)
        velocity = self._velocity if now - self._heard <= self._silence else Velocity()
        self.problem = self._find_problem(now)
        keys = TeleopCommand() if self._keys is None else self._keys.command(now)
        if self._rises:
            # Arming is refused to an operator who asks for a velocity.
            self._rises = False
            return TeleopCommand(arm=True, stop=keys.stop)
        return replace(keys, **velocity._asdict())

    def drain(self, now: float) -> None:
        """Forget keys and messages from before the run."""
        for reader in self._readers:
            reader.take(1)
        if self._keys is not None:
            self._keys.drain(now)

    def close(self) -> None:
        """Give the terminal back."""
        getattr(self._keys, "close", lambda: None)()

    def _listen(self, now: float) -> None:
        """Take over the newest message, if one came and its numbers are finite."""
        samples = []
        for reader in self._readers:
            samples += reader.take(1)
        for sample in samples:
            # Absent when a publisher has left, and None if the payload is of another type.
            values = getattr(sample, "values", None)
            if values is None:
                continue
            self._malformed = not np.isfinite(sample.raw.view("<f8")).all()
            if not self._malformed:
                self._velocity = Velocity(
                    forward=float(values["linear"]["x"]),
                    left=float(values["linear"]["y"]),
                    turn_rate=float(values["angular"]["z"]),
                )
                self._heard = now

    def _find_problem(self, now: float) -> str:
        """Return the topic's problem in a line; empty if there is none."""
        if now - self._counted >= COUNT_EVERY:
            self._counted = now
            self._publishers = 0
            for reader in self._readers:
                self._publishers += len(reader.get_matched_publications())
        if self._malformed:
            return f"{self._topic} carries a value that is not finite: such messages are left out"
        if self._publishers > 1:
            return f"{self._publishers} publishers on {self._topic}: the newest message counts"
        if now - self._heard > self._silence:
            return f"no message on {self._topic} for {self._silence:g} s: the robot stands"
        return ""
