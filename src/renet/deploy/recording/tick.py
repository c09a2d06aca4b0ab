"""Fields of a recorded control tick, as a NumPy record and as a ROS 2 message.

The bytes of a record are the CDR payload of the message: fields are ordered by the size of their
numbers, so that none needs padding.
"""

from dataclasses import fields
from typing import NamedTuple

import numpy as np

from renet.deploy.controller import Decision
from renet.deploy.robots.base import VECTORS
from renet.deploy.safety.machine import Mode
from renet.deploy.teleop.base import TeleopCommand
from renet.interface import ACTION_SIZE, LATENT

NONE = 0
"""Code of a tick without a reading or frame."""
GOOD = 1
"""Code of a reading or frame that was recorded."""
BAD = 2
"""Code of a reading or frame that was malformed."""
READINGS = ("NONE", "GOOD", "BAD")
"""Names of these codes."""
MODES = tuple(Mode)
"""Modes of the safety machine by their recorded number."""
_NUMPY_TYPES = {"float64": "<f8", "int64": "<i8", "float32": "<f4", "uint8": "u1", "bool": "?"}
"""NumPy types by their names in ROS 2."""


class Field(NamedTuple):
    """Field of a message: a number or an array of numbers."""

    kind: str
    """A key of `_NUMPY_TYPES`."""
    name: str
    size: int
    """Length of the array; 0 for a single number."""
    comment: str
    values: tuple[str, ...] = ()
    """Names of the values 0, 1, …, which viewers show instead."""


TICK_FIELDS = (
    Field("float64", "now", 0, "time of the control tick, s on the robot's clock"),
    Field("float64", "state_time", 0, "time of the reading, s"),
    *(Field("float64", name, size, "of the reading, SI units") for name, size in VECTORS.items()),
    Field("float64", "forward", 0, "velocity that the operator asks for, m/s"),
    Field("float64", "left", 0, "likewise, m/s"),
    Field("float64", "turn_rate", 0, "likewise, rad/s"),
    Field("float64", "frame_time", 0, "time at which the newest depth frame was taken, s"),
    Field("float64", "frame_invalid", 0, "share of its pixels without a measurement"),
    Field("float64", "position", ACTION_SIZE, "joint targets, rad"),
    Field("float64", "stiffness", ACTION_SIZE, "Kp of the joint servos, N m/rad"),
    Field("float64", "damping", ACTION_SIZE, "Kd of the joint servos, N m s/rad"),
    Field("int64", "frame_number", 0, "the camera's own count of frames"),
    Field("float32", "map_error", 0, "error of its height map that VP expects, m"),
    Field("float32", "probability", 0, "vision probability"),
    Field("float32", "anomaly", 0, "reconstruction loss of the newest images"),
    Field("float32", "variance", 0, "their error over its predicted variance"),
    Field("float32", "surprise", 0, "their contradiction to the images before"),
    Field("float32", "stillness", 0, "share of the expected change that they lack"),
    Field("float32", "frame_age", 0, "age of the newest good frame, s"),
    Field("float32", "action", ACTION_SIZE, "policy units"),
    Field("float32", "latent", LATENT, "latent that drove this tick"),
    Field("float32", "told", 3, "velocity or heading that the policy was told"),
    Field("float32", "velocity_op", 3, "estimate of OP, m/s in the base frame"),
    Field("float32", "velocity_vp", 3, "estimate of VP, m/s in the base frame"),
    Field("float32", "compute_ms", 0, "duration of the controller's tick, ms"),
    Field("float32", "base_position", 3, "in the world, m; NaN where it is not known"),
    Field("uint8", "state", 0, "the reading", READINGS),
    Field("uint8", "frame", 0, "the depth frame", READINGS),
    Field("uint8", "mode", 0, "mode of the safety machine", tuple(MODES)),
    Field("bool", "new_image", 0, "the next image of /depth came with this tick"),
    Field("bool", "arm", 0, "the operator asks to stand up and walk"),
    Field("bool", "stop", 0, "the operator asks to stop"),
    Field("bool", "vision", 0, "VP drove this tick"),
    Field("bool", "has_image", 0, "VP had an image; without one it goes on from memory"),
    Field("bool", "inferred", 0, "the result of a vision tick was taken over"),
    Field("bool", "fallback", 0, "the vision tick ran blind because its thread was late"),
)
POWER_FIELDS = (
    Field("float64", "now", 0, "time of the control tick, s on the robot's clock"),
    Field("float32", "temperature", ACTION_SIZE, "of each motor, degrees Celsius"),
    Field("float32", "battery", 0, "charge, 0 to 1"),
    Field("float32", "voltage", 0, "of the battery, V"),
)
"""Fields of a power record; values that a robot does not send are NaN."""


def record(message: tuple[Field, ...]) -> np.dtype:
    """NumPy record type of a message."""
    entries = []
    for field in message:
        shape = (field.size,) if field.size else ()
        entries.append((field.name, _NUMPY_TYPES[field.kind], shape))
    return np.dtype(entries)


def definition(message: tuple[Field, ...]) -> str:
    """ROS 2 definition (`.msg`) of a message."""
    lines = []
    for field in message:
        # Constants of the message name the values of a field.
        for number, value in enumerate(field.values):
            lines.append(f"{field.kind} {field.name.upper()}_{value.upper()}={number}")
        array = f"[{field.size}]" if field.size else ""
        lines.append(f"{field.kind}{array} {field.name}  # {field.comment}")
    return "\n".join(lines) + "\n"


TICK_DTYPE = record(TICK_FIELDS)
"""Record of a control tick: inputs, decision, duration, and position of the base."""
POWER_DTYPE = record(POWER_FIELDS)
"""Record of temperatures, charge and voltage, which hold until the next one."""
WISHES = tuple(field.name for field in fields(TeleopCommand))
"""Fields of an operator's command, all of which are recorded."""
_DECISION = {field.name for field in fields(Decision)}
DECIDED = tuple(name for name in TICK_DTYPE.names or () if name in _DECISION - {"mode"})
"""Fields of a `Decision` that are recorded as they are."""
