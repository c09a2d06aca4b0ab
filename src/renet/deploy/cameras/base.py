"""What every depth camera offers: images prepared exactly as in training."""

from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np

from renet.bundle.manifest import CameraSpec
from renet.deploy.robots.driver import RobotDriver


@dataclass(frozen=True)
class DepthFrame:
    """One image. Drivers report what they got: the controller checks it."""

    image: np.ndarray
    """[48, 64] planar depth divided by the range, in [0, 1], top row first, holes filled."""
    number: int
    """The sensor's own count of frames."""
    time: float
    """Seconds on the robot's clock at which it was taken."""
    invalid: float = 0.0
    """Share of pixels without a measurement, before holes were filled."""


class Camera(Protocol):
    """A depth camera that never makes its caller wait."""

    busy: bool = False
    """Whether the robot may not be disturbed: it is not braked."""

    def start(self) -> None:
        """Begin to stream; raises RenetError with what to do when that fails."""

    def latest(self) -> DepthFrame | None:
        """Newest frame, the same one until the next arrives; None before the first."""

    def close(self) -> None:
        """Stop streaming; safe to call twice."""


@dataclass(frozen=True)
class CameraCfg:
    """A camera that `renet deploy --camera NAME` looks through; its fields are options."""

    simulated: ClassVar[bool] = False
    """Whether it looks at a simulation: a real robot has none."""

    def check(self) -> None:
        """Raise RenetError for options that cannot work."""

    def build(self, camera: CameraSpec, robot: RobotDriver, seed: int) -> Camera | None:
        """Make a camera of the bundle's images without starting it; None is no camera at all.

        The robot's clock times its frames; `seed` is that of a simulated camera's noise.

        Raises:
            RenetError: a package or file is missing, or the camera cannot give such images.
        """
        return None
