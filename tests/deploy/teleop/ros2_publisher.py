"""A ROS 2 node without ROS, told lines of JSON: `python ros2_publisher.py DOMAIN TOPIC [FRAME]`.

With a frame's name it publishes TwistStamped, otherwise Twist. Its types are written from the
Twist.msg, TwistStamped.msg and Vector3.msg of geometry_msgs, Header.msg of std_msgs and Time.msg of
builtin_interfaces, as rosidl names them in IDL
(`module geometry_msgs { module msg { module dds_ { struct Vector3_ { double x; …`), and know
nothing of renet. A line is a list of six numbers, which are published once.
"""

import json
import sys
from dataclasses import dataclass

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import float64, int32, uint32
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


@dataclass
class Time_(IdlStruct, typename="builtin_interfaces.msg.dds_.Time_"):
    sec: int32
    nanosec: uint32


@dataclass
class Header_(IdlStruct, typename="std_msgs.msg.dds_.Header_"):
    stamp: Time_
    frame_id: str


@dataclass
class TwistStamped_(IdlStruct, typename="geometry_msgs.msg.dds_.TwistStamped_"):
    header: Header_
    twist: Twist_


def publish(domain: int, topic: str, frame: str | None) -> None:
    joined = Domain(domain, LOOPBACK)
    participant = DomainParticipant(domain)
    # ROS 2's default: reliable, volatile, the last 10.
    qos = Qos(Policy.Reliability.Reliable(100_000_000), Policy.History.KeepLast(10))
    message = Twist_ if frame is None else TwistStamped_
    writer = DataWriter(participant, Topic(participant, f"rt/{topic}", message), qos)
    print("ready", flush=True)
    for line in sys.stdin:
        values = json.loads(line)
        twist = Twist_(Vector3_(*values[:3]), Vector3_(*values[3:]))
        if frame is None:
            writer.write(twist)
        else:
            writer.write(TwistStamped_(Header_(Time_(12, 34), frame), twist))
    del joined


if __name__ == "__main__":
    publish(int(sys.argv[1]), sys.argv[2], sys.argv[3] if sys.argv[3:] else None)
