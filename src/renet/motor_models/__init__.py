"""Motors that simulated robots may have, by what `--motors` takes."""

import hashlib
from pathlib import Path

from renet.errors import RenetError
from renet.files import MAX_JSON, read_bytes
from renet.motor_models.network import MotorNetwork, read_network
from renet.motors import MotorFit, read_motors

IDEAL = "ideal"
"""MuJoCo's own servos."""
NETWORK = "go1"
"""The network of a real Go1's motors."""
MotorModel = MotorNetwork | MotorFit
"""Motors that are not ideal."""


def find_motors(name: str, robot: str) -> MotorModel | None:
    """Find the motors that `--motors` names.

    Args:
        name: `ideal` (None is returned), `go1`, or a file of `renet identify`.
        robot: Name of the robot whose motors they must be.

    Raises:
        RenetError: No such motors, or those of another robot.
    """
    if name == IDEAL:
        return None
    if name == NETWORK:
        network = read_network()
        if robot != network.robot:
            raise RenetError(
                f"the motors {NETWORK} are a {network.robot}'s, and this robot is a {robot}: "
                "measure its own with `renet identify`"
            )
        return network
    _demand_file(name)
    return read_motors(Path(name), robot)


def motors_key(name: str) -> str:
    """Text that differs where the motors that `--motors` names differ; raises RenetError."""
    if name in (IDEAL, NETWORK):
        return name
    _demand_file(name)
    return hashlib.sha256(read_bytes(Path(name), MAX_JSON, "motors")).hexdigest()


def _demand_file(name: str) -> None:
    """Raise RenetError for a name that is neither known nor a file's."""
    if not Path(name).exists():
        raise RenetError(
            f"motors must be {IDEAL}, {NETWORK} or a file of `renet identify`; there is no {name!r}"
        )
