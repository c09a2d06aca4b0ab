"""The driver of the Unitree Go2."""

from importlib.util import find_spec

from renet.deploy.robots.envelope import read_envelope
from renet.deploy.robots.real.driver import SINK, RealRobot
from renet.descriptions import GO2
from renet.errors import RenetError, install

DOMAIN = 0
"""DDS domain of every Go2."""


class Go2Robot(RealRobot):
    """A Go2 behind a sender process, which releases the robot's own controllers."""

    def __init__(
        self,
        interface: str,
        domain: int = DOMAIN,
        watch: bool = False,
        timeout: float = 20.0,
        sink: float = SINK,
    ) -> None:
        """Set up without talking to the robot.

        Args:
            interface: network card that the robot is at. domain: its DDS domain.
            watch: only look: its own controllers go on, and it is never commanded.
            timeout: seconds `connect` waits for the robot and for its controllers' end.
            sink: seconds of braking with which the connection ends.
        """
        super().__init__(
            "Go2",
            read_envelope(GO2),
            "renet.deploy.robots.go2.link:Go2Link",
            (interface, domain, watch),
            f"no answer from a Go2 on {interface}: check the cable and this computer's address "
            "(192.168.123.x), and that the robot has started (`ping 192.168.123.161`)",
            timeout,
            sink,
        )

    def connect(self) -> None:
        """Start the sender and wait for the robot; raises RenetError with what to do."""
        if find_spec("cyclonedds") is None:
            raise RenetError(
                f"the Go2 needs Cyclone DDS: {install('go2')} (docs/go2.md says what to do on ARM)"
            )
        super().connect()
