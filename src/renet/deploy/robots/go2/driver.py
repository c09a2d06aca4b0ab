"""The driver of the Unitree Go2."""

from renet.deploy.dds.requirements import demand_dds
from renet.deploy.robots.real.driver import RealRobot
from renet.robots import GO2


def go2_robot(
    interface: str, domain: int = 0, watch: bool = False, timeout: float = 20.0, **options: float
) -> RealRobot:
    """Make the driver of a Go2 behind a sender process, without connecting it.

    Once connected, the sender releases the motors from the robot's own controllers.

    Args:
        interface: Network card that the robot is connected to.
        domain: The robot's DDS domain; every Go2's is 0.
        watch: Only watch: the robot's own controllers go on, and it is never commanded.
        timeout: Time that `connect` waits for the robot and the end of its controllers, s.
        options: `sink` of `RealRobot`.

    Raises:
        RenetError: Cyclone DDS is not installed.
    """
    demand_dds("the Go2")
    return RealRobot(
        "Go2",
        GO2,
        "renet.deploy.robots.go2.link:Go2Link",
        (interface, domain, watch),
        f"no answer from a Go2 on {interface}: check the cable and this computer's address "
        "(192.168.123.x), and that the robot has started (`ping 192.168.123.161`)",
        timeout,
        **options,
    )
