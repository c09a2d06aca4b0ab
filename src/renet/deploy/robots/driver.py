"""What every robot driver offers, and how `renet deploy` makes one."""

from dataclasses import dataclass
from typing import ClassVar, Protocol

from renet.bundle.manifest import RobotSpec
from renet.deploy.robots.base import JointCommand, RobotState
from renet.robots import Robot


class RobotDriver(Protocol):
    """A robot, real or simulated, with a clock of its own.

    One that has a method `show` is asked to show itself to the user at every control step.
    """

    description: Robot
    """Description of the robot, whose limits no bundle can widen."""

    def connect(self) -> None:
        """Begin to talk; raises RenetError with what to do when that fails."""

    def read(self) -> RobotState | None:
        """Newest reading, without waiting; None before the first."""

    def write(self, command: JointCommand) -> None:
        """Hand a command to the joint servos, which hold it until the next."""

    def now(self) -> float:
        """Seconds on the robot's clock, never decreasing."""
        ...

    def wait(self, until: float) -> None:
        """Let time pass until `now()` reaches `until`; return at once if it has."""

    def close(self) -> None:
        """Let go of the robot; safe to call twice."""


@dataclass(frozen=True)
class DriverCfg:
    """A robot that `renet deploy --robot NAME` drives; its fields are options of the command."""

    simulated: ClassVar[bool] = False
    """Whether the robot lives in this process, on a clock of its own."""
    drives: ClassVar[Robot | None] = None
    """The only robot that it drives; None: any that a bundle may have."""
    bundle: ClassVar[str | None] = None
    """Name of the bundle that ships for this robot; None: that of the Go1."""
    camera: ClassVar[str] = "realsense"
    """Name of the camera that `--camera auto` means."""

    @property
    def live(self) -> bool:
        """Whether the robot's clock is the wall's."""
        return not self.simulated

    @property
    def address(self) -> str:
        """What tells this robot from others of its kind, such as a port.

        Only one program at a time drives the robot at an address; by default, one of a kind.
        """
        return ""

    def check(self) -> None:
        """Raise RenetError for options that cannot work."""

    def build(self, robot: RobotSpec, live: bool, seed: int, dry_run: bool) -> RobotDriver:
        """Make the driver without connecting it.

        Args:
            robot: the bundle's. live: whether a simulation is paced to the wall clock.
            seed: of a simulation's randomness. dry_run: nothing will be commanded.

        Raises:
            RenetError: the bundle is another robot's, or a package or file is missing.
        """
        raise NotImplementedError
