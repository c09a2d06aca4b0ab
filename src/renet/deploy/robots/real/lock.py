"""One robot, one controller: what a driver holds for as long as anything may command its robot."""

import errno
import socket

from renet.errors import RenetError

LONGEST = 100
"""Bytes of an address that count: the system takes 107 for a name."""


def claim(robot: str) -> socket.socket:
    """Hold a robot until this process and all that inherit the socket have closed it or are dead.

    The lock is an abstract Unix socket, a name without a file: whoever may reach the robot over the
    same network sees it, and the system frees it however its holders end. `robot` is what tells
    it from others, such as its name and address.

    Raises:
        RenetError: another program on this computer holds it.
    """
    lock = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        lock.bind(b"\0renet/" + robot.encode()[:LONGEST])
    except OSError as error:
        lock.close()
        if error.errno != errno.EADDRINUSE:
            raise
        raise RenetError(
            f"another program on this computer drives the {robot}: end it first"
        ) from error
    return lock
