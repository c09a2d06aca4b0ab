"""Interface of depth cameras, whose images are prepared exactly as in training."""

from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np

from renet.bundle.manifest import CameraSpec
from renet.deploy.robots.base import RobotDriver


@dataclass(frozen=True)
class DepthFrame:
    """One depth image as a driver received it; the controller checks it."""

    image: np.ndarray
    """[48, 64] planar depth divided by the camera's range, 0 to 1, top row first, holes filled."""
    number: int
    """Number of the frame by the sensor's own count."""
    time: float
    """Time at which it was taken, s on the robot's clock."""
    invalid: float = 0.0
    """Share of pixels without a measurement before holes were filled, 0 to 1."""


class Camera(Protocol):
    """Depth camera whose methods return without waiting for an image.

    It may have an attribute `problem`, which is told to the operator when it changes, and in a
    simulation a method `perturb`, which changes what it sees by a `faults.ViewPerturbation`.
    """

    busy: bool = False
    """True while the robot is not braked, and must not be delayed by the camera."""

    def start(self) -> None:
        """Begin to stream; raises RenetError with what to do when that fails."""

    def latest(self) -> DepthFrame | None:
        """Return the newest frame, the same one until the next arrives; None before the first."""

    def close(self) -> None:
        """Stop streaming; a second call does nothing."""


@dataclass(frozen=True)
class CameraCfg:
    """Camera of `renet deploy --camera NAME`; its fields are options of the command."""

    simulated: ClassVar[bool] = False
    """True for a camera in a simulation, which a real robot cannot use."""

    def check(self) -> None:
        """Raise RenetError for options that cannot work."""

    def build(self, spec: CameraSpec, robot: RobotDriver, seed: int) -> Camera | None:
        """Make the camera without starting it; None stands for a run without a camera.

        Args:
            spec: Format of the images that the bundle's policy needs.
            robot: Robot on whose clock frames are timed.
            seed: Seed of a simulated camera's noise.

        Raises:
            RenetError: A package or file is missing, or the camera has no images of this format.
        """
        return None


def next_due(due: float, taken: float, period: float) -> float:
    """Return the time from which the next frame of a steady camera is due, s.

    A frame that is a little late leaves the camera's beat as it is. After a pause the beat begins
    anew, and the frames that were left out are not made up for.

    Args:
        due: Time from which the newest frame was due, s.
        taken: Time of the newest frame, s.
        period: Time between two frames, s.
    """
    if taken >= due + period:
        return taken + period
    return due + period
