"""Velocities from a ROS 2 topic, read through Cyclone DDS; ROS itself is not needed.

ROS 2's topics are DDS topics by other names: `cmd_vel` is `rt/cmd_vel`, and the type of
`geometry_msgs/msg/Twist` is `geometry_msgs::msg::dds_::Twist_`.
"""

import math
import os
import re
from dataclasses import replace

import numpy as np

from renet.deploy.robots.go2.messages import TWIST, message_type
from renet.deploy.robots.go2.network import Network
from renet.deploy.teleop import Teleop, TeleopCommand, Velocity
from renet.errors import RenetError

Twist = message_type("Twist_", TWIST, "geometry_msgs.msg.dds_")
TOPIC = re.compile(r"/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
"""Names of ROS 2's topics, without those that ROS itself would expand."""
LAST_DOMAIN = 232
"""Highest DDS domain whose ports exist."""
COUNT_EVERY = 1.0
"""Seconds between two counts of the publishers."""


def domain_of(given: int | None) -> int:
    """DDS domain to join: the given one, or ROS 2's own choice, the variable ROS_DOMAIN_ID.

    Raises:
        RenetError: it is no number from 0 to 232.
    """
    text = os.environ.get("ROS_DOMAIN_ID") or "0"
    source = "ROS_DOMAIN_ID" if given is None else "--ros-domain"
    value = text if given is None else str(given)
    if not (value.isascii() and value.isdigit() and int(value) <= LAST_DOMAIN):
        raise RenetError(f"{source} must be from 0 to {LAST_DOMAIN}, got {value}")
    return int(value)


class Ros2Teleop:
    """Walks as the newest message on a topic says, and stands once there is none any more.

    A message carries no wish to stand up or to stop: those are the keyboard's.
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
            topic: ROS 2's name of it, such as cmd_vel.
            interface: network card to listen at; empty: Cyclone DDS chooses, as it does for ROS 2.
            silence: seconds without a message after which the robot stands.
            keys: keyboard that arms, stops and quits, if there is one.
            rises: whether the robot is armed at once.

        Raises:
            RenetError: no such interface, or DDS that fails.
        """
        self._topic = topic
        self._reader = Network(interface, domain).reader(f"rt/{topic.removeprefix('/')}", Twist)
        self._keys = keys
        self._silence = silence
        self._velocity = Velocity()
        self._heard = -math.inf
        self._counted = -math.inf
        self._publishers = 0
        self._malformed = False
        self._rises = rises
        self.attended = keys is not None
        ends = "r stand up and walk, space stop, q quit" if keys else "Ctrl-C quits"
        self.controls = f"velocities of {topic} in domain {domain}, {ends}"
        self.problem = ""
        """What the operator is to know; empty if all is well."""

    @property
    def quit(self) -> bool:
        """Whether the run is to end."""
        return getattr(self._keys, "quit", False)

    def command(self, now: float) -> TeleopCommand:
        """The newest velocity, with the keyboard's wishes to arm and to stop."""
        self._listen(now)
        velocity = self._velocity if now - self._heard <= self._silence else Velocity()
        self.problem = self._find_problem(now)
        keys = TeleopCommand() if self._keys is None else self._keys.command(now)
        if self._rises:
            # Without a velocity, with which arming would be refused.
            self._rises = False
            return TeleopCommand(arm=True, stop=keys.stop)
        return replace(keys, **velocity._asdict())

    def drain(self, now: float) -> None:
        """Forget the keys and messages that came before a run."""
        self._reader.take(1)
        if self._keys is not None:
            self._keys.drain(now)

    def close(self) -> None:
        """Give the terminal back."""
        getattr(self._keys, "close", lambda: None)()

    def _listen(self, now: float) -> None:
        """Take the newest message over, if one came; one that is malformed is none."""
        for sample in self._reader.take(1):
            values = getattr(sample, "values", None)  # Absent where a publisher has left.
            if values is None:
                continue
            self._malformed = not np.isfinite(sample.raw.view("<f8")).all()
            if not self._malformed:
                linear, angular = values["linear"], values["angular"]
                self._velocity = Velocity(
                    float(linear["x"]), float(linear["y"]), float(angular["z"])
                )
                self._heard = now

    def _find_problem(self, now: float) -> str:
        if now - self._counted >= COUNT_EVERY:
            self._counted = now
            self._publishers = len(self._reader.get_matched_publications())
        if self._malformed:
            return f"{self._topic} carries a value that is not finite: such messages are left out"
        if self._publishers > 1:
            return f"{self._publishers} publishers on {self._topic}: the newest message counts"
        if now - self._heard > self._silence:
            return f"no message on {self._topic} for {self._silence:g} s: the robot stands"
        return ""
