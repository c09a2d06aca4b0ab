"""Physical faults, in which the camera works but sees another scene than the feet touch.

They cannot be applied to an image. A fault describes the difference between a camera's view and the
scene, and a simulated environment casts its rays accordingly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from renet.errors import RenetError
from renet.faults.base import Fault, Frames

if TYPE_CHECKING:
    import mujoco

_LEAST_RISE = 0.001
"""Rise above the start from which a box is an obstacle, m."""


@dataclass(frozen=True)
class ViewPerturbation:
    """Difference between the views of n cameras and their scenes."""

    lift: np.ndarray
    """Height by which all surfaces appear too high, [n] m."""
    turn: np.ndarray
    """Rotation vector of the camera in its mount, camera axes (forward, left, up), [n, 3] rad."""
    glass: np.ndarray
    """Share of the obstacles that rays pass through, but feet do not, [n]."""

    @classmethod
    def none(cls, n: int) -> ViewPerturbation:
        """Return no difference, of n cameras."""
        return cls(lift=np.zeros(n), turn=np.zeros((n, 3)), glass=np.zeros(n))

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, ViewPerturbation):
            return False
        return all(map(np.array_equal, vars(self).values(), vars(other).values()))


class PhysicalFault(Fault):
    """Fault of the scene or the mount, which does not change frames."""

    def corrupt(self, frames: Frames, elapsed: np.ndarray) -> Frames:
        """Return the same frames, whose rays were cast into the wrong scene already."""
        return frames

    def apply(self, view: ViewPerturbation, rows: np.ndarray, elapsed: float) -> None:
        """Add the fault to the view of some robots, in place.

        Args:
            view: View of all robots.
            rows: Indices of the fault's robots, in the order of its random streams.
            elapsed: Time since the fault began, s.
        """
        raise NotImplementedError


class Glass(PhysicalFault):
    """Obstacles vanish from the camera's rays and stay in the robot's way; level is their share, at
    least one.
    """

    unit = "share"
    levels = (0.2, 0.4, 0.6, 0.8, 1.0)
    terrains = ("obstacles", "stairs_up", "platform")
    """Kinds of tile with obstacles that can be glass."""

    def apply(self, view: ViewPerturbation, rows: np.ndarray, elapsed: float) -> None:
        view.glass[rows] = np.maximum(view.glass[rows], self.level)


class Foam(PhysicalFault):
    """Every surface appears higher than the ground that carries, as with foam, snow or tall grass;
    level is by how much.
    """

    unit = "m"
    levels = (0.02, 0.04, 0.07, 0.1, 0.15)

    def apply(self, view: ViewPerturbation, rows: np.ndarray, elapsed: float) -> None:
        view.lift[rows] += self.level


class MountKnocked(PhysicalFault):
    """A knock has turned the camera about a random axis; level is the angle."""

    unit = "°"
    levels = (3, 6, 10, 15, 25)

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        return rng.standard_normal(3)

    def apply(self, view: ViewPerturbation, rows: np.ndarray, elapsed: float) -> None:
        view.turn[rows] += np.radians(self.angle(elapsed)) * unit_vectors(self.patterns)

    def angle(self, elapsed: float) -> float:
        """Return the angle of the turn in degrees, `elapsed` s after the onset."""
        return self.level


class MountCreep(MountKnocked):
    """The mount gives way: the camera turns further and further about a random axis, by 25° at
    most; level is how fast.

    Cameras move in their mounts while they are in use, and nothing notices
    (github.com/huggingface/lerobot/issues/4496).
    """

    unit = "°/s"
    levels = (0.75, 1.5, 2.5, 4, 6)

    def angle(self, elapsed: float) -> float:
        return min(self.level * elapsed, MountKnocked.levels[-1])


def unit_vectors(vectors: Sequence[np.ndarray]) -> np.ndarray:
    """Scale vectors [n, 3] to length 1."""
    directions = np.array(vectors)
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def obstacles(model: mujoco.MjModel, middles: np.ndarray) -> list[list[int]]:
    """List each tile's obstacles: geoms of boxes that rise above its start and do not span it.

    Obstacles of a course are the boxes of `OBSTACLE_GROUP`.

    Args:
        model: Scene with terrain.
        middles: Centres of the tiles in the world frame, [T, 2] m.

    Raises:
        RenetError: The terrain has no obstacles.
    """
    import mujoco

    from renet.terrain.tiles import OBSTACLE_GROUP, TILE

    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    half_size = model.geom_size[:, :2]
    centre = data.geom_xpos[:, :2]
    top = data.geom_xpos[:, 2] + model.geom_size[:, 2]
    is_terrain = model.body_rootid[model.geom_bodyid] == model.body("terrain").id
    is_box = model.geom_type == mujoco.mjtGeom.mjGEOM_BOX
    carries_start = (np.abs(middles[:, None] - centre) <= half_size).all(axis=2).any(axis=0)
    # A tile is a body, whose robots start on the highest box of its middle.
    start = np.full(model.nbody, -np.inf)
    carriers = np.flatnonzero(is_terrain & is_box & carries_start)
    np.maximum.at(start, model.geom_bodyid[carriers], top[carriers])
    is_higher = top > start[model.geom_bodyid] + _LEAST_RISE
    is_within_tile = (half_size < TILE / 2 - 1e-6).all(axis=1)
    # The group of a course's obstacles replaces the rule for tiles.
    is_grouped = is_terrain & (model.geom_group == OBSTACLE_GROUP)
    is_obstacle = is_grouped | (is_higher & is_within_tile & ~is_grouped.any())
    geoms = np.flatnonzero(is_terrain & is_box & is_obstacle)
    if not len(geoms):
        raise RenetError(
            "this terrain has no obstacle that could be glass: choose obstacles, stairs_up or"
            " platform"
        )
    tiles = model.geom_bodyid[geoms]
    return [geoms[tiles == tile].tolist() for tile in np.unique(tiles)]


def choose_evenly(tiles: list[list[int]], share: float) -> frozenset[int]:
    """Choose a share of the geoms of each tile, at least one, evenly spaced in their order."""
    choice: set[int] = set()
    for geoms in tiles:
        # A geom is chosen where the rounded number of geoms up to it grows.
        counts = np.ceil(np.arange(len(geoms) + 1) * share - 1e-9)
        choice.update(np.array(geoms)[np.diff(counts) > 0].tolist())
    return frozenset(choice)
