"""`manifest.json`: everything a robot must agree with before it runs three ONNX models."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from renet.camera import Intrinsics
from renet.errors import RenetError
from renet.interface import (
    DEPTH_RANGE,
    DEPTH_SHAPE,
    FRAMES,
    HEADING_PROPRIOCEPTION,
    HISTORY,
    JOINTS,
    PROPRIOCEPTION,
    Term,
    Told,
)
from renet.selector.selector import SelectorSpec, check_selector

NEWEST_SCHEMA = 2
"""Version of the manifests that renet writes."""
READABLE_SCHEMAS = (1, NEWEST_SCHEMA)
"""Versions that renet reads; version 1 knows no memory."""
_JOINT_NUMBERS = ("default_position", "stiffness", "damping", "torque_limit", "lower", "upper")
"""Fields of `RobotSpec` with one number for each joint."""


@dataclass(frozen=True)
class RobotSpec:
    """The robot that a policy was trained on; lists are in the order of `joints`."""

    name: str
    joints: tuple[str, ...]
    default_position: tuple[float, ...]
    """rad"""
    stiffness: tuple[float, ...]
    """Kp, N m/rad."""
    damping: tuple[float, ...]
    """Kd, N m s/rad."""
    torque_limit: tuple[float, ...]
    """N m"""
    lower: tuple[float, ...]
    """rad, hard limit."""
    upper: tuple[float, ...]
    """rad, hard limit."""
    action_scale: float
    """rad of joint target per policy unit."""
    action_clip: float
    """Policy units."""

    def __post_init__(self) -> None:
        _demand(self.joints, "robot.joints must not be empty")
        for name in _JOINT_NUMBERS:
            size = len(getattr(self, name))
            count = len(self.joints)
            _demand(size == count, f"robot.{name} must have {count} numbers, it has {size}")
        for name in ("stiffness", "damping"):
            _demand(min(getattr(self, name)) >= 0.0, f"robot.{name} must not be negative")
        for name in ("torque_limit", "action_scale", "action_clip"):
            _demand(np.min(getattr(self, name)) > 0.0, f"robot.{name} must be positive")
        ranges = zip(self.joints, self.lower, self.default_position, self.upper, strict=True)
        for joint, low, middle, high in ranges:
            _demand(
                low < high and low <= middle <= high,
                f"robot.default_position of {joint}, {middle} rad, must be between robot.lower, "
                f"{low} rad, and robot.upper, {high} rad",
            )

    @cached_property
    def arrays(self) -> dict[str, np.ndarray]:
        """The lists of numbers as arrays by name, [12] each, made once for all control steps."""
        return {name: np.array(getattr(self, name)) for name in _JOINT_NUMBERS}


@dataclass(frozen=True)
class CameraSpec:
    """Depth image and camera that a policy was trained on."""

    fx: float
    """Focal length in pixels of the cropped, resized image."""
    fy: float
    cx: float
    cy: float
    height: int = DEPTH_SHAPE[0]
    width: int = DEPTH_SHAPE[1]
    range: float = DEPTH_RANGE
    """Range of the camera, m; images are divided by it."""
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Position of the camera in the base frame, m."""
    pitch: float = 0.0
    """Downward tilt, rad."""
    rate_hz: float = 10.0
    noise_std: float = 0.1
    """Standard deviation of the constant part of the depth error in training, m, which simulated
    cameras add, too."""

    def __post_init__(self) -> None:
        shape = (self.height, self.width)
        _demand(shape == DEPTH_SHAPE, f"camera image must be {DEPTH_SHAPE}, it is {shape}")
        for name in ("fx", "fy", "range", "rate_hz"):
            _demand(getattr(self, name) > 0.0, f"camera.{name} must be positive")
        _demand(self.noise_std >= 0.0, "camera.noise_std must not be negative")

    @property
    def intrinsics(self) -> Intrinsics:
        """Intrinsics of the cropped, resized image."""
        return Intrinsics(self.height, self.width, self.fx, self.fy, self.cx, self.cy)


@dataclass(frozen=True)
class ProvenanceSpec:
    """Origin of the weights; `steps` are of all robots together, `seconds` those of training."""

    task: str = ""
    iteration: int = 0
    steps: int = 0
    seconds: float = 0.0
    seed: int = 0
    perception: str = "renet"
    encoder: str = "attention"
    date: str = ""
    renet: str = ""


@dataclass(frozen=True)
class Manifest:
    """Manifest of a bundle; `sha256` maps the names of its models' files to digests."""

    robot: RobotSpec
    camera: CameraSpec
    selector: SelectorSpec
    provenance: ProvenanceSpec = ProvenanceSpec()
    history: int = HISTORY
    frames: int = FRAMES
    proprioception: tuple[Term, ...] = PROPRIOCEPTION
    sha256: dict[str, str] = field(default_factory=dict)
    schema: int = NEWEST_SCHEMA

    def __post_init__(self) -> None:
        _demand(0 < self.history <= 100, f"history must be 1 to 100, got {self.history}")
        check_selector(self.selector)
        _demand(self.frames == FRAMES, f"frames must be {FRAMES}, got {self.frames}")
        if self.robot.joints != JOINTS:
            raise RenetError(
                f"the bundle's joint order is {', '.join(self.robot.joints)}; this renet uses "
                f"{', '.join(JOINTS)}"
            )
        # The runtime makes the observations of these two alone.
        if self.proprioception not in (PROPRIOCEPTION, HEADING_PROPRIOCEPTION):
            raise RenetError("the bundle's proprioception differs from this renet's")

    @property
    def told(self) -> Told:
        """Form of the policy's command, see `interface.TOLD`."""
        return "twist" if self.proprioception == PROPRIOCEPTION else "heading"


def _demand(holds: Any, what: str) -> None:
    """Raise RenetError with the message `what` unless a condition holds."""
    if not holds:
        raise RenetError(what)
