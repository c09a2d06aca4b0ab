"""Physical faults: the camera works, but shows another scene than the one the feet meet.

They cannot be painted on an image. A fault describes how a camera's view differs from the scene,
and a simulated environment casts its rays accordingly.
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


@dataclass(frozen=True)
class ViewPerturbation:
    """How the views of n cameras differ from their scenes."""

    lift: np.ndarray
    """[n] m by which every surface appears higher than it is."""
    turn: np.ndarray
    """[n, 3] rotation vector of the camera in its mount, rad, camera axes (forward, left, up)."""
    glass: np.ndarray
    """[n] share of the obstacles that rays pass through, and feet do not."""

    @classmethod
    def none(cls, n: int) -> ViewPerturbation:
        """No difference."""
        return cls(np.zeros(n), np.zeros((n, 3)), np.zeros(n))

    def __eq__(self, other: object) -> bool:
        """Whether all numbers are equal."""
        same_kind = isinstance(other, ViewPerturbation)
        return same_kind and all(map(np.array_equal, vars(self).values(), vars(other).values()))


class PhysicalFault(Fault):
    """A fault of the scene or the mount, which leaves frames as they are."""

    def corrupt(self, frames: Frames, elapsed: np.ndarray) -> Frames:
        """The same frames, whose rays were cast into the wrong scene already."""
        return frames

    def apply(self, view: ViewPerturbation, rows: np.ndarray, elapsed: float) -> None:
        """Add the fault to the view of the robots `rows`, which are in the order of the streams.

        `elapsed` is the number of seconds since the fault began.
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
        """Degrees by which the camera is turned some seconds after the fault began."""
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
    """Vectors of length 1, [n, 3], in the directions of others."""
    directions = np.array(vectors)
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def obstacles(model: mujoco.MjModel, middles: np.ndarray) -> list[list[int]]:
    """Geoms of each tile's obstacles: boxes that neither span the tile nor carry its start.

    Courses name theirs by their group.

    Args:
        model: a scene with terrain; raises RenetError without obstacles.
        middles: [tiles, 2] m, world.
    """
    import mujoco

    from renet.terrain.tiles import OBSTACLE_GROUP, TILE

    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    half, centre = model.geom_size[:, :2], data.geom_xpos[:, :2]
    in_terrain = model.body_rootid[model.geom_bodyid] == model.body("terrain").id
    box = model.geom_type == mujoco.mjtGeom.mjGEOM_BOX
    start = (np.abs(middles[:, None] - centre) <= half).all(axis=2).any(axis=0)
    within_tile = (half < TILE / 2 - 1e-6).all(axis=1)
    named = in_terrain & (model.geom_group == OBSTACLE_GROUP)
    geoms = np.flatnonzero(in_terrain & box & (named | (~start & within_tile & ~named.any())))
    if not len(geoms):
        raise RenetError(
            "this terrain has no obstacle that could be glass: choose obstacles, stairs_up or"
            " platform"
        )
    tiles = model.geom_bodyid[geoms]
    return [geoms[tiles == tile].tolist() for tile in np.unique(tiles)]


def spread(tiles: list[list[int]], share: float) -> frozenset[int]:
    """A share of the geoms of each tile, at least one, spread evenly over their order."""
    chosen: set[int] = set()
    for geoms in tiles:
        counts = np.ceil(np.arange(len(geoms) + 1) * share - 1e-9)
        chosen.update(np.array(geoms)[np.diff(counts) > 0].tolist())
    return frozenset(chosen)
