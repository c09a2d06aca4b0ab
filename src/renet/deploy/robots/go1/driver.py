"""The driver of the Unitree Go1."""

import socket

from renet.deploy.robots.real.driver import RealRobot
from renet.errors import RenetError, reason
from renet.robots import GO1

POWER_LEVEL = 9
"""Level of the vendor's overload guard, from 1 (10 % of the motors' power) to 10."""


def demand_power_level(level: int) -> None:
    """Raise RenetError for a level that the overload guard does not have."""
    if not 1 <= level <= 10:
        raise RenetError(f"the Go1's power level must be 1 to 10, got {level}")


def go1_robot(
    host: str = "192.168.123.10",
    port: int = 8007,
    local_port: int = 8080,
    power_level: int = POWER_LEVEL,
    **options: float,
) -> RealRobot:
    """Make the driver of a Go1 behind a sender process, without connecting it.

    Args:
        host: Address of the robot's motor board.
        port: Port of the motor board.
        local_port: Port of this computer to which the motor board answers.
        power_level: Level of the vendor's overload guard, 1 to 10.
        options: `timeout` and `sink` of `RealRobot`.

    Raises:
        RenetError: The host is unknown, or there is no such power level.
    """
    demand_power_level(power_level)
    try:
        host = socket.gethostbyname(host)
    except OSError as error:
        raise RenetError(f"no robot at {host!r}: {reason(error)}") from error
    return RealRobot(
        "Go1",
        GO1,
        "renet.deploy.robots.go1.link:Go1Link",
        (host, port, local_port, power_level),
        f"no answer from a Go1 at {host}:{port}: check the cable and this computer's address "
        "(192.168.123.x), and that the robot is in low-level mode (L2+A, L2+B, then "
        "L1+L2+START, hanging or lying)",
        **options,
    )
