"""The driver of the Unitree Go1."""

import socket

from renet.deploy.robots.envelope import read_envelope
from renet.deploy.robots.go1.link import unitree
from renet.deploy.robots.real.driver import SINK, RealRobot
from renet.descriptions import GO1
from renet.errors import RenetError

ROBOT_HOST, ROBOT_PORT, LOCAL_PORT = "192.168.123.10", 8007, 8080
POWER_LEVEL = 9
"""Level of the vendor's overload guard, from 1 (10 % of the motors' power) to 10."""


class Go1Robot(RealRobot):
    """A Go1 behind a sender process."""

    def __init__(
        self,
        host: str = ROBOT_HOST,
        port: int = ROBOT_PORT,
        local_port: int = LOCAL_PORT,
        power_level: int = POWER_LEVEL,
        timeout: float = 5.0,
        sink: float = SINK,
    ) -> None:
        """Set up without talking to the robot.

        Args:
            host, port: of the robot's motor board. local_port: where it answers to.
            power_level: of the vendor's overload guard.
            timeout: seconds `connect` waits for the first answer.
            sink: seconds of braking with which the connection ends.
        """
        if not 1 <= power_level <= 10:
            raise RenetError(f"the Go1's power level must be 1 to 10, got {power_level}")
        try:
            host = socket.gethostbyname(host)
        except OSError as error:
            raise RenetError(f"no robot at {host!r}: {error}") from error
        self._local_port = local_port
        super().__init__(
            "Go1",
            read_envelope(GO1),
            "renet.deploy.robots.go1.link:Go1Link",
            (host, port, local_port, power_level),
            f"no answer from a Go1 at {host}:{port}: check the cable and this computer's "
            "address (192.168.123.x), and that the robot is in low-level mode (L2+A, "
            "L2+B, then L1+L2+START, hanging or lying)",
            timeout,
            sink,
        )

    def connect(self) -> None:
        """Start the sender and wait for the robot; raises RenetError with what to do."""
        unitree()
        _claim(self._local_port)
        super().connect()


def _claim(port: int) -> None:
    """Raise RenetError if this computer already talks to a robot; the library would not mind."""
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("", port))
    except OSError as error:
        raise RenetError(
            f"UDP port {port} is taken: another program already talks to the Go1; end it first"
        ) from error
