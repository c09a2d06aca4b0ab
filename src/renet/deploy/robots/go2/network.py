"""DDS as a Go2 and ROS 2 speak it, on one network card.

A Go2's is always named. ROS 2's may be left to Cyclone DDS, as ROS 2 leaves it.
"""

import socket
import time
from functools import cache
from importlib.metadata import version
from typing import Any

from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
from cyclonedds.core import DDSException, Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from renet.deploy.robots.go2.messages import read_types
from renet.errors import RenetError

CYCLONEDDS = "11.0.1"
"""The only version whose private attributes this has been tried with."""
INTERFACE_CONFIG = (
    '<CycloneDDS><Domain Id="any"><General><Interfaces><NetworkInterface name="{}" '
    'multicast="true"/></Interfaces></General></Domain></CycloneDDS>'
)
"""Left to itself, Cyclone DDS announces itself on the first network card."""
PLAIN_CDR = Policy.DataRepresentation(use_cdrv0_representation=True)
NEVER_WAIT = Policy.Reliability.Reliable(max_blocking_time=0)
"""A reader that does not acknowledge must not hold up the motors' next command."""
ANNOUNCED = 2.0
"""Seconds within which Cyclone DDS says what it announced."""


@cache
def _join(domain: int, interface: str) -> Domain:
    """The domain, for as long as the process lives; it has one interface only."""
    return Domain(domain, INTERFACE_CONFIG.format(interface))


class Network:
    """One participant of a DDS domain."""

    def __init__(self, interface: str, domain: int = 0) -> None:
        """Join a domain (the robot's is 0) on the network card of this name, such as eth0.

        Without a name, Cyclone DDS takes the one that CYCLONEDDS_URI says, or the first.

        Raises:
            RenetError: no such interface, another version of Cyclone DDS, or one that fails.
        """
        if version("cyclonedds") != CYCLONEDDS:
            raise RenetError(
                f"the Go2 and ROS 2 need cyclonedds {CYCLONEDDS}, this is {version('cyclonedds')}: "
                "other versions may crash the programs that they talk to"
            )
        names = [name for _, name in socket.if_nameindex()]
        if interface and interface not in names:
            raise RenetError(f"no network interface {interface!r} here, only {', '.join(names)}")
        self._types = read_types()
        try:
            if interface:
                _join(domain, interface)
            self._participant = DomainParticipant(domain)
        except DDSException as error:
            where = f" on {interface}" if interface else ""
            raise RenetError(f"cannot use DDS{where}: {error.msg}") from error

    def writer(self, topic: str, message: Any, depth: int = 1) -> DataWriter:
        """A writer that never waits, and sends the newest `depth` messages again if they are lost.

        Raises:
            RenetError: it would announce another type than the robot does.
        """
        qos = Qos(PLAIN_CDR, NEVER_WAIT, Policy.History.KeepLast(depth))
        writer = DataWriter(self._participant, self._topic(topic, message), qos)
        self._check(topic, message.__name__)
        return writer

    def reader(self, topic: str, message: Any, depth: int = 1) -> DataReader:
        """A reader of the newest `depth` messages, but for this participant's own."""
        qos = Qos(PLAIN_CDR, Policy.History.KeepLast(depth), Policy.IgnoreLocal.Participant)
        return DataReader(self._participant, self._topic(topic, message), qos)

    def _topic(self, name: str, message: Any) -> Topic:
        idl = message.__idl__
        idl.populate()
        idl._xt_data = (idl, idl)  # Not None: it is not to be made anew.
        idl._xt_bytedata = self._types[message.__name__]
        return Topic(self._participant, name, message, Qos(PLAIN_CDR))

    def _check(self, topic: str, name: str) -> None:
        """Raise RenetError unless Cyclone DDS announced a writer as the robot would."""
        published = BuiltinDataReader(self._participant, BuiltinTopicDcpsPublication)
        deadline = time.monotonic() + ANNOUNCED
        while time.monotonic() < deadline:
            for endpoint in published.take(100):
                local = endpoint.participant_key == self._participant.guid
                if local and endpoint.topic_name == topic:
                    if endpoint.type_id.value in self._types[name][0]:
                        return
                    raise RenetError(f"Cyclone DDS announces {name} in a way that may crash robots")
            time.sleep(0.01)
        raise RenetError(f"Cyclone DDS does not say how it announced {name}")
