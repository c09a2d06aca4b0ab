"""Measured motors of a robot, and the file in which `renet identify` writes them.

Simulators read it, so it needs neither PyTorch nor MuJoCo. The file is JSON:

    {"format": "renet motors", "schema": 1, "robot": "Unitree Go2",
     "motors": {"hip": {"armature": 0.01, "damping": 0.2, "friction": 0.3, "delay": 0.004},
                "thigh": {…}, "calf": {…}},
     "evidence": {…}}

Names under `motors` are kinds of joints (hip, thigh, calf), joints of `interface.JOINTS`, or both:
a joint's own values come before its kind's.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from renet.conversion import from_json
from renet.errors import RenetError
from renet.files import read_object, write_atomically
from renet.interface import JOINTS

MOTORS_FORMAT = "renet motors"
"""Name of the format in a file."""
SCHEMA = 1
"""Version of the files that renet writes and reads."""
REMEDY = "mend the file, or measure anew with `renet identify`"
"""Advice on a file that cannot be used."""
KINDS = ("hip", "thigh", "calf")
"""Kinds of joints, each with motors of one kind."""


def joint_kind(joint: str) -> str:
    """Return the kind of a joint of `interface.JOINTS`: hip, thigh or calf."""
    return joint.split("_")[1]


@dataclass(frozen=True)
class MotorParameters:
    """Parameters that a motor adds to its joint, besides the servo's Kp and Kd."""

    armature: float
    """Reflected inertia of the rotor, kg m^2; MuJoCo's joint `armature`."""
    damping: float
    """Viscous friction in addition to the servo's Kd, N m s/rad; MuJoCo's joint `damping`."""
    friction: float
    """Dry friction, N m; MuJoCo's joint `frictionloss`."""
    delay: float
    """Time from a joint target to its effect, s."""


PARAMETERS = tuple(item.name for item in fields(MotorParameters))
"""Names of the parameters: armature, damping, friction, delay."""
LARGEST = MotorParameters(armature=10.0, damping=100.0, friction=100.0, delay=1.0)
"""Largest values in a file, far above those of any quadruped's motors."""


@dataclass(frozen=True)
class MotorFit:
    """Measured motors of one robot.

    Raises:
        RenetError: A motor has an unknown name, a joint has no motor, or a value is implausible.
    """

    robot: str
    """Name of the robot, as in a bundle's manifest and in its description."""
    motors: Mapping[str, MotorParameters]
    """Parameters by kind of joint (hip, thigh, calf), by joint of `interface.JOINTS`, or both."""
    evidence: Mapping[str, Any] = field(default_factory=dict)
    """Description of the measurement: log, errors, uncertainty; JSON values, which simulators
    ignore."""

    def __post_init__(self) -> None:
        for name, motor in self.motors.items():
            if name not in KINDS and name not in JOINTS:
                raise RenetError(
                    f"there is no joint {name[:40]!r}: motors are of {', '.join(KINDS)}, or of "
                    f"joints such as {JOINTS[0]}"
                )
            _check_values(name, motor)
        for joint in JOINTS:
            if joint not in self.motors and joint_kind(joint) not in self.motors:
                raise RenetError(f"there is no motor for {joint}: add {joint_kind(joint)!r}")

    def of(self, joint: str) -> MotorParameters:
        """Return the parameters of a joint of `interface.JOINTS`."""
        return self.motors[joint if joint in self.motors else joint_kind(joint)]

    def array(self, parameter: str) -> np.ndarray:
        """Return one of `PARAMETERS` for all joints, [12] in the order of `interface.JOINTS`."""
        return np.array([getattr(self.of(joint), parameter) for joint in JOINTS])


def _check_values(name: str, motor: MotorParameters) -> None:
    """Raise RenetError for a value that is negative, not finite or beyond all motors."""
    for parameter in PARAMETERS:
        value = getattr(motor, parameter)
        largest = getattr(LARGEST, parameter)
        # The comparison is false for NaN, too.
        if not 0.0 <= value <= largest:
            raise RenetError(
                f"the {parameter} of {name} must be a number from 0 to {largest:g}, got {value:g}"
            )


def read_motors(path: Path, robot: str | None = None) -> MotorFit:
    """Read a file of `write_motors`.

    Args:
        path: Path of the file.
        robot: Name of the robot that the motors must belong to; None for any.

    Raises:
        RenetError: The file cannot be read, is of another kind, version or robot, or has
            implausible values.
    """
    content = read_object(path, "motors")
    if content.get("format") != MOTORS_FORMAT:
        raise RenetError(
            f"{path} is not a file of `renet identify`: its format is not {MOTORS_FORMAT!r}"
        )
    if content.get("schema") != SCHEMA:
        raise RenetError(
            f"{path} has schema {str(content.get('schema'))[:40]}; this renet reads {SCHEMA}"
        )
    source = f"the motors {path}"
    # Evidence is for people: it may hold texts of any length, and errors that are not finite.
    evidence = content.get("evidence", {})
    if not isinstance(evidence, dict):
        raise RenetError(f"cannot use {source}: evidence must be an object; {REMEDY}")
    # One by one, so that messages name the motor.
    for name, values in from_json(dict[str, Any], content.get("motors"), source, REMEDY).items():
        from_json(MotorParameters, values, f"{name[:40]!r} of {source}", REMEDY)
    values = {name: content[name] for name in ("robot", "motors") if name in content}
    fit = replace(from_json(MotorFit, values, source, REMEDY), evidence=evidence)
    if robot is not None and fit.robot != robot:
        raise RenetError(f"the motors {path} are of a {fit.robot[:40]}, not of a {robot}")
    return fit


def write_motors(path: Path, fit: MotorFit) -> None:
    """Write measured motors as JSON; raises RenetError if the file cannot be written."""
    content = {
        "format": MOTORS_FORMAT,
        "schema": SCHEMA,
        "robot": fit.robot,
        "motors": {name: asdict(motor) for name, motor in fit.motors.items()},
        "evidence": dict(fit.evidence),
    }
    write_atomically(path, (json.dumps(content, indent=1) + "\n").encode(), "motors")
