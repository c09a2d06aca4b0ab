"""Interface of robot drivers, and the settings by which `renet deploy` makes one."""

from dataclasses import dataclass
from typing import ClassVar, Protocol

from renet.bundle.manifest import RobotSpec
from renet.deploy.robots.base import JointCommand, RobotState
from renet.robots import Robot


class RobotDriver(Protocol):
    """Robot, real or simulated, with a clock of its own.

    It may have a method `show`, which is called at every control step to show it to the user; an
    attribute `refused` after `connect`, a line for the user about what the system refused it; and
    in a simulation `base_position`, [3] m in the world, which is recorded.
    """

    description: Robot
    """Description of the robot, whose limits no bundle can widen."""

    def connect(self) -> None:
        """Begin to talk to the robot; raises RenetError that says what to do if that fails."""

    def read(self) -> RobotState | None:
        """Return the newest reading, without waiting; None before the first."""

    def write(self, command: JointCommand) -> None:
        """Hand a command to the joint servos, which hold it until the next."""

    def now(self) -> float:
        """Return the time on the robot's clock, s, which never decreases."""
        ...

    def wait(self, until: float) -> None:
        """Let time pass until `now()` reaches `until`; return at once if it has."""

    def close(self) -> None:
        """Let go of the robot; a second call does nothing."""


@dataclass(frozen=True)
class DriverCfg:
    """Robot of `renet deploy --robot NAME`; its fields are options of the command."""

    simulated: ClassVar[bool] = False
    """True if the robot lives in this process, on a clock of its own."""
    drives: ClassVar[Robot | None] = None
    """The only robot that it drives; None if it drives any that a bundle may have."""
    bundle: ClassVar[str | None] = None
    """Name of the bundle that ships for this robot; None: that of the Go1."""
    camera: ClassVar[str] = "realsense"
    """Name of the camera that `--camera auto` means."""

    @property
    def live(self) -> bool:
        """True if the robot's clock is the wall's."""
        return not self.simulated

    @property
    def address(self) -> str:
        """Address that tells this robot from others of its kind, such as a port.

        Only one program at a time drives the robot at an address. By default there is only one
        robot of a kind.
        """
        return ""

    def check(self) -> None:
        """Raise RenetError for options that cannot work."""

    def build(self, spec: RobotSpec, live: bool, seed: int, dry_run: bool) -> RobotDriver:
        """Make the driver without connecting it.

        Args:
            spec: Robot of the bundle.
            live: Pace a simulation to the wall clock.
            seed: Seed of a simulation's randomness.
            dry_run: Nothing will be commanded.

        Raises:
            RenetError: The bundle is another robot's, or a package or file is missing.
        """
        raise NotImplementedError
