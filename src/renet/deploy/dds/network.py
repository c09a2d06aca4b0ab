"""DDS of a Go2 and of ROS 2, on one network card.

The card of a Go2 is always named. That of ROS 2 may be left to Cyclone DDS, as ROS 2 itself does.
"""

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

from renet.deploy.dds.messages import read_types
from renet.deploy.dds.requirements import demand_card
from renet.errors import RenetError

CYCLONEDDS = "11.0.1"
"""Only version of Cyclone DDS whose private attributes, used here, have been tested."""
INTERFACE_CONFIG = (
    '<CycloneDDS><Domain Id="any"><General><Interfaces><NetworkInterface name="{}" '
    'multicast="true"/></Interfaces></General></Domain></CycloneDDS>'
)
"""Configuration for one card; without it, Cyclone DDS announces itself on the first one."""
PLAIN_CDR = Policy.DataRepresentation(use_cdrv0_representation=True)
NEVER_WAIT = Policy.Reliability.Reliable(max_blocking_time=0)
"""Quality of service by which a reader that does not acknowledge cannot delay a command."""
ANNOUNCED = 2.0
"""Time within which Cyclone DDS must say what it announced, s."""


@cache
def _join(domain: int, interface: str) -> Domain:
    """Join a domain on one interface, for as long as the process lives."""
    return Domain(domain, INTERFACE_CONFIG.format(interface))


class Network:
    """Participant of a DDS domain."""

    def __init__(self, interface: str, domain: int = 0) -> None:
        """Join a domain.

        Args:
            interface: Name of a network card, such as eth0. If empty, Cyclone DDS takes the card
                of the variable CYCLONEDDS_URI, or the first.
            domain: DDS domain; a robot's is 0.

        Raises:
            RenetError: There is no such interface, Cyclone DDS has another version, or it fails.
        """
        if version("cyclonedds") != CYCLONEDDS:
            raise RenetError(
                f"the Go2 and ROS 2 need cyclonedds {CYCLONEDDS}, this is {version('cyclonedds')}: "
                "other versions may crash the programs that they talk to"
            )
        if interface:
            demand_card(interface)
        self._types = read_types()
        try:
            if interface:
                _join(domain, interface)
            self._participant = DomainParticipant(domain)
        except DDSException as error:
            where = f" on {interface}" if interface else ""
            raise RenetError(f"cannot use DDS{where}: {error.msg}") from error

    def writer(self, topic: str, message: Any, depth: int = 1) -> DataWriter:
        """Make a writer that never waits, and repeats the newest `depth` messages if they are lost.

        Raises:
            RenetError: It would announce another type than the robot does.
        """
        qos = Qos(PLAIN_CDR, NEVER_WAIT, Policy.History.KeepLast(depth))
        writer = DataWriter(self._participant, self._topic(topic, message), qos)
        self._check(topic, message.__name__)
        return writer

    def reader(self, topic: str, message: Any, depth: int = 1) -> DataReader:
        """Make a reader of the newest `depth` messages, without this participant's own."""
        qos = Qos(PLAIN_CDR, Policy.History.KeepLast(depth), Policy.IgnoreLocal.Participant)
        return DataReader(self._participant, self._topic(topic, message), qos)

    def _topic(self, name: str, message: Any) -> Topic:
        idl = message.__idl__
        idl.populate()
        # Anything but None keeps Cyclone DDS from making its own type information, with which the
        # robot's version crashes.
        idl._xt_data = (idl, idl)
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
