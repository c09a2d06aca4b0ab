"""A ROS 2 node without ROS, told lines of JSON: `python ros2_publisher.py DOMAIN TOPIC`.

Its types are written from geometry_msgs' Twist.msg and Vector3.msg, as rosidl names them in IDL
(`module geometry_msgs { module msg { module dds_ { struct Vector3_ { double x; …`), and know
nothing of renet. A line is a list of six numbers, which are published once.
"""

import json
import sys
from dataclasses import dataclass

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import float64
from cyclonedds.pub import DataWriter
from cyclonedds.topic import Topic

LOOPBACK = (
    '<CycloneDDS><Domain Id="any"><General><Interfaces><NetworkInterface name="lo" '
    'multicast="true"/></Interfaces></General></Domain></CycloneDDS>'
)


@dataclass
class Vector3_(IdlStruct, typename="geometry_msgs.msg.dds_.Vector3_"):
    x: float64
    y: float64
    z: float64


@dataclass
class Twist_(IdlStruct, typename="geometry_msgs.msg.dds_.Twist_"):
    linear: Vector3_
    angular: Vector3_


def publish(domain: int, topic: str) -> None:
    joined = Domain(domain, LOOPBACK)
    participant = DomainParticipant(domain)
    # ROS 2's default: reliable, volatile, the last 10.
    qos = Qos(Policy.Reliability.Reliable(100_000_000), Policy.History.KeepLast(10))
    writer = DataWriter(participant, Topic(participant, f"rt/{topic}", Twist_), qos)
    print("ready", flush=True)
    for line in sys.stdin:
        values = json.loads(line)
        writer.write(Twist_(Vector3_(*values[:3]), Vector3_(*values[3:])))
    del joined


if __name__ == "__main__":
    publish(int(sys.argv[1]), sys.argv[2])
