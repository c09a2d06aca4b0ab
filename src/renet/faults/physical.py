"""Faults of the scene and of the mount (users' severities, see docs)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from renet.faults.view import PhysicalFault, View


class Glass(PhysicalFault):
    """The camera measures what lies behind an obstacle."""

    name = "glass"
    summary = (
        "Obstacles vanish from the camera's rays and stay in the robot's way; level is their share,"
        " at least one."
    )
    unit = "share"
    levels = (0.2, 0.4, 0.6, 0.8, 1.0)
    terrains = ("obstacles", "stairs_up", "platform")
    """Kinds of tile with obstacles that can be glass."""

    def bend(self, view: View, rows: np.ndarray) -> None:
        """See `PhysicalFault.bend`."""
        view.glass[rows] = np.maximum(view.glass[rows], self.level)


class Foam(PhysicalFault):
    """Foam, snow or tall grass: the surface that is seen does not carry."""

    name = "foam"
    summary = "Every surface appears higher than the ground that carries; level is by how much."
    unit = "m"
    levels = (0.02, 0.04, 0.07, 0.1, 0.15)

    def bend(self, view: View, rows: np.ndarray) -> None:
        """See `PhysicalFault.bend`."""
        view.lift[rows] += self.level


class MountKnocked(PhysicalFault):
    """A knock has turned the camera in its mount."""

    name = "mount_knocked"
    summary = "The camera is turned about a random axis; level is the angle."
    unit = "°"
    levels = (3, 6, 10, 15, 25)

    def __init__(self, level: float, rngs: Sequence[np.random.Generator]) -> None:
        super().__init__(level, rngs)
        axes = np.array([rng.standard_normal(3) for rng in rngs]).reshape(-1, 3)
        axes /= np.linalg.norm(axes, axis=1, keepdims=True)
        self._turn = np.radians(level) * axes
        """[n, 3]"""

    def bend(self, view: View, rows: np.ndarray) -> None:
        """See `PhysicalFault.bend`."""
        view.turn[rows] += self._turn
