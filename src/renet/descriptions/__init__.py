"""Robots by the name that bundles give them: what simulators and drivers must know of each.

A bundle brings its policy's joints, gains and camera. A description holds what no bundle may
decide: the model of the body, and the limits of its motors.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from renet.errors import RenetError

FOLDER = Path(__file__).parent


@dataclass(frozen=True)
class RobotDescription:
    """One robot of twelve joints."""

    name: str
    """Name of the robot in a bundle's manifest."""
    mjcf: Path
    """MJCF of the robot alone: a body `interface.TRUNK` with a free joint, and the joints of
    `interface.JOINTS`, each with a range and with a `general` actuator of its name and force range.
    Geoms of group 3 collide with the terrain (contype 0, conaffinity 1)."""
    height: float
    """Height of the trunk above the ground at the start of a simulation, m."""
    speeds: Mapping[str, float]
    """Fastest motion of `hip`, `thigh` and `calf` joints, rad/s: MJCF has no field for it."""
    stiffness: float = 100.0
    """Largest Kp that its driver sends, N m/rad; published policies of the Go1 use 20 to 40."""
    damping: float = 10.0
    """Largest Kd that its driver sends, N m s/rad; they use 0.5 to 1."""


DESCRIPTIONS: dict[str, RobotDescription] = {}
"""Every robot that can be simulated and driven, by name; `register_description` adds one."""


def register_description(description: RobotDescription) -> RobotDescription:
    """Make a robot known to simulators and drivers; returns its description."""
    DESCRIPTIONS[description.name] = description
    return description


def find_description(name: str) -> RobotDescription:
    """The description of a bundle's robot; raises RenetError if there is none."""
    if name not in DESCRIPTIONS:
        raise RenetError(
            f"the bundle drives a {name}, which has no description here: there is one of "
            f"{', '.join(DESCRIPTIONS)} (docs/robots.md says how to add one)"
        )
    return DESCRIPTIONS[name]


GO1 = register_description(
    RobotDescription(
        name="Unitree Go1",
        mjcf=FOLDER / "go1.xml",  # Written by tools/robot_models.py from the one that is trained.
        height=0.30,
        speeds={"hip": 30.1, "thigh": 30.1, "calf": 20.06},  # The vendor's model.
    )
)
GO2 = register_description(
    RobotDescription(
        name="Unitree Go2",
        mjcf=FOLDER / "go2.xml",  # Written by tools/robot_models.py; training reads it, too.
        height=0.30,
        speeds={"hip": 30.1, "thigh": 30.1, "calf": 15.7},  # The vendor's URDF.
    )
)
