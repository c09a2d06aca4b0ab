"""Positions and velocities of a robot's feet from the angles and speeds of its joints."""

import xml.etree.ElementTree as ET

import numpy as np

from renet.errors import RenetError
from renet.interface import LEGS, TRUNK
from renet.robots import Robot


class Legs:
    """Kinematics of four legs, each with a hip that rolls, and a thigh and a calf that pitch."""

    def __init__(self, robot: Robot) -> None:
        """Read the lengths of the legs from a robot's model.

        Raises:
            RenetError: the joints turn about other axes, a body is rotated at rest, or the robot
                has no model file.
        """
        if robot.mjcf is None:
            raise RenetError(f"the model of a {robot.name} is no file: give it `mjcf`")
        root = ET.parse(robot.mjcf).getroot()
        trunk = next(body for body in root.iter("body") if body.get("name") == TRUNK)
        # [4 legs, 4 parts, 3] to four arrays [4 legs, 3] m.
        parts = [_leg(trunk, leg, robot.name) for leg in LEGS]
        self._hip, self._thigh, self._calf, self._foot = np.array(parts).swapaxes(0, 1)

    def feet(self, angles: np.ndarray, speeds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities of the feet in the frame of the base.

        Args:
            angles: [12] rad, of the joints.
            speeds: [12] rad/s, of the joints.

        Returns:
            [4, 3] m and [4, 3] m/s, in the order of `interface.LEGS`.
        """
        hip, thigh, calf = angles.reshape(4, 3).T
        hip_speed, thigh_speed, calf_speed = speeds.reshape(4, 3).T
        # From the foot inwards: each joint turns everything beyond it.
        shin = _pitched(self._foot, calf)
        shank = self._calf + shin
        leg = _pitched(shank, thigh)
        # The calf moves the shin; the angle of the thigh turns that motion into the hip's frame.
        knee = _pitched(_pitch_motion(shin, calf_speed), thigh)
        motion = knee + _pitch_motion(leg, thigh_speed)
        arm = self._thigh + leg
        position = _rolled(arm, hip)
        velocity = _rolled(motion, hip) + _roll_motion(position, hip_speed)
        return self._hip + position, velocity


def _leg(trunk: ET.Element, leg: str, robot: str) -> list[np.ndarray]:
    """Offsets [3] m of a leg's hip, thigh, calf and foot, each in the body before it."""
    offsets = []
    body = trunk
    for part, axis in (("hip", "1 0 0"), ("thigh", "0 1 0"), ("calf", "0 1 0")):
        joint = f"joint[@name='{leg}_{part}_joint'][@axis='{axis}']"
        body = next((child for child in body.iter("body") if child.find(joint) is not None), None)
        if body is None or body.get("quat"):
            raise RenetError(f"the legs of a {robot} are not those of a hip, a thigh and a calf")
        offsets.append(_vector(body))
    # The foot may be a site of a body that is fixed to the calf.
    foot = next((site for site in body.iter("site") if site.get("name") == leg), None)
    if foot is None:
        raise RenetError(f"a {robot} has no site named {leg!r} at its foot")
    inner = next((child for child in body.findall("body") if foot in child.iter("site")), None)
    beyond = np.zeros(3) if inner is None else _vector(inner)
    return [*offsets, beyond + _vector(foot)]


def _vector(element: ET.Element) -> np.ndarray:
    return np.array((element.get("pos") or "0 0 0").split(), float)


def _pitched(arm: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Arms [4, 3] turned about y by angles [4] rad."""
    cosine = np.cos(angle)
    sine = np.sin(angle)
    x, y, z = arm.T
    return np.stack((cosine * x + sine * z, y, cosine * z - sine * x), axis=1)


def _rolled(arm: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Arms [4, 3] turned about x by angles [4] rad."""
    cosine = np.cos(angle)
    sine = np.sin(angle)
    x, y, z = arm.T
    return np.stack((x, cosine * y - sine * z, sine * y + cosine * z), axis=1)


def _pitch_motion(arm: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """Velocities [4, 3] m/s of arms that turn about y at speeds [4] rad/s."""
    x, y, z = arm.T
    return np.stack((speed * z, 0.0 * y, -speed * x), axis=1)


def _roll_motion(arm: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """Velocities [4, 3] m/s of arms that turn about x at speeds [4] rad/s."""
    x, y, z = arm.T
    return np.stack((0.0 * x, -speed * z, speed * y), axis=1)
