"""A network that was fitted to the motors of a real Unitree Go1.

`go1.npz` holds the weights of `resources/actuator_nets/unitree_go1.pt` of walk-these-ways (Margolis
and Agrawal, 2022), under the MIT license beside it. For each joint, at 200 Hz, it tells the torque
from the position error now, one and two samples ago, and from the velocity at the same times. The
motors were told Kp 20 and Kd 0.5.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

WEIGHTS = Path(__file__).with_name("go1.npz")
LAYERS = 3
SAMPLES = 3
"""Position errors, and velocities, that the network sees of each joint."""


@dataclass(frozen=True)
class MotorNetwork:
    """A perceptron with softsign units from a joint's latest samples to its torque."""

    robot: str
    """Name of the robot whose motors these are."""
    stiffness: float
    """Kp that the motors were told when they were measured, N m/rad."""
    damping: float
    """Kd that they were told, N m s/rad."""
    layers: tuple[tuple[Any, Any], ...]
    """Weights [out, in] and biases [out] of each layer: NumPy arrays, or PyTorch tensors."""

    def torque(self, errors: Any, velocities: Any) -> Any:
        """Torques [...], N m, before a motor's limit.

        Args:
            errors: position less target, [..., 3] rad, newest first, scaled by `scale_error`.
            velocities: [..., 3] rad/s, newest first, scaled by `scale_velocity`.
        """
        (weight, bias), *others = self.layers
        hidden = errors @ weight[:, :SAMPLES].T + velocities @ weight[:, SAMPLES:].T + bias
        for weight, bias in others:
            softsign = hidden / (1.0 + abs(hidden))
            hidden = softsign @ weight.T + bias
        return hidden[..., 0]

    def scale_error(self, error: Any, stiffness: Any) -> Any:
        """Error as the network is to see it where motors are told another Kp.

        A motor's torque is taken to depend on Kp times the error alone.
        """
        return error * (stiffness / self.stiffness)

    def scale_velocity(self, velocity: Any, damping: Any) -> Any:
        """Velocity as the network is to see it where motors are told another Kd."""
        return velocity * (damping / self.damping)

    def converted(self, convert: Callable[[np.ndarray], Any]) -> "MotorNetwork":
        """The same network with its arrays converted, such as to tensors."""
        layers = tuple((convert(weight), convert(bias)) for weight, bias in self.layers)
        return replace(self, layers=layers)


@cache
def read_network() -> MotorNetwork:
    """The network of a Go1's motors, with NumPy arrays."""
    with np.load(WEIGHTS) as arrays:
        layers = tuple((arrays[f"weight_{n}"], arrays[f"bias_{n}"]) for n in range(LAYERS))
    return MotorNetwork(robot="Unitree Go1", stiffness=20.0, damping=0.5, layers=layers)
