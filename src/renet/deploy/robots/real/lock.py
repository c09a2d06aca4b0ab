"""Lock on a robot, held for as long as any process of this computer may command it."""

import errno
import socket

from renet.errors import RenetError

_LONGEST = 100
"""Largest size of a robot's address, bytes; the system takes 107 for a name."""


def claim(robot: str) -> socket.socket:
    """Lock a robot until this process and all that inherit the socket have closed it or ended.

    The lock is an abstract Unix socket, a name without a file: all programs that reach the robot
    over this network see it, and the system frees it however its holders end. `robot` tells the
    robot from others, such as its name and address.

    Raises:
        RenetError: Another program on this computer holds it.
    """
    lock = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        lock.bind(b"\0renet/" + robot.encode()[:_LONGEST])
    except OSError as error:
        lock.close()
        if error.errno != errno.EADDRINUSE:
            raise
        raise RenetError(
            f"another program on this computer drives the {robot}: end it first"
        ) from error
    return lock
