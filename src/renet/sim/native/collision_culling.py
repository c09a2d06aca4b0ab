"""Collision culling: exclusion of static bodies out of a robot's reach from collision detection.

C MuJoCo computes the bounds of all colliding geoms in each step. For a robot on one tile of a large
terrain that takes longer than its own dynamics. MuJoCo skips bodies whose collision masks are zero.
Bodies out of reach would have no contact, so that results are the same.
"""

import mujoco
import numpy as np

from renet.sim.native.copy_tables import FieldCopy

MASKS = ("body_contype", "body_conaffinity")
TRAVEL = 0.5
"""Distance beyond a robot's reach within which bodies stay collidable, m. Masks are computed again
when a robot has moved by half of it; the steps of one call must not move it by the other half."""


class CollisionCulling:
    """Collision masks of each environment's bodies, zero for static bodies out of reach.

    Reach is measured from the positions of free-floating roots. In models with fixed bases, sliding
    joints or mocap bodies no body is excluded.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, num_envs: int) -> None:
        """Compute reach and bounds.

        Args:
            model: The model.
            data: Its data after `mj_forward`.
            num_envs: Number N of environments.
        """
        self.masks = [np.tile(getattr(model, name), (num_envs, 1)) for name in MASKS]
        """Masks [N, nbody] of both kinds, which engine.cpp writes."""
        # The masks without any exclusion.
        whole = [mask[0].copy() for mask in self.masks]
        roots, reach = _roots(model)
        bodies = _bounded_static_bodies(model) if roots else np.empty(0, int)
        bounds = [_bounds(model, data, body) for body in bodies]
        self.fields = {
            "bodies": len(bodies),
            "roots": len(roots),
            "model_bodies": model.nbody,
            "body": bodies.astype(np.int32),
            "bounds": np.array(bounds, np.float32),
            "column": np.array(roots, np.int32),
            "reach": np.array(reach, np.float32),
            "half_travel": TRAVEL / 2,
            "last": np.full((num_envs, len(roots), 2), np.nan, np.float32),
            **dict(zip(("contype", "conaffinity"), self.masks, strict=True)),
            **dict(zip(("whole_contype", "whole_conaffinity"), whole, strict=True)),
        }
        """Fields of the struct Culling of engine.cpp."""

    def load_masks(self, model: mujoco.MjModel) -> list[FieldCopy]:
        """List copies of the masks into a worker's model; empty if no body is excluded."""
        if not self.fields["bodies"]:
            return []
        copies = []
        for mask, name in zip(self.masks, MASKS, strict=True):
            copies.append(FieldCopy(mask, getattr(model, name)))
        return copies


def _roots(model: mujoco.MjModel) -> tuple[list[int], list[float]]:
    """Find the free joints and the reach of the trees below them.

    Returns:
        Addresses of the joints in qpos, and reach in m. Both are empty if the reach of a tree has
        no limit.
    """
    free = model.jnt_type == mujoco.mjtJoint.mjJNT_FREE
    moving_trees = np.unique(model.body_rootid[model.jnt_bodyid])
    has_slides = (model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE).any()
    if model.nmocap or has_slides or free.sum() != len(moving_trees):
        return [], []
    addresses = model.jnt_qposadr[free].tolist()
    reach = [_extent(model, body) + TRAVEL for body in model.jnt_bodyid[free].tolist()]
    return addresses, reach


def _extent(model: mujoco.MjModel, body: int) -> float:
    """Compute a radius around a body's frame that contains its subtree at all joint angles, m."""
    radii = [0.0]
    first = model.body_geomadr[body]
    for geom in range(first, first + model.body_geomnum[body]):
        radii.append(np.linalg.norm(model.geom_pos[geom]) + model.geom_rbound[geom])
    for child in np.flatnonzero(model.body_parentid == body):
        # The world is its own parent.
        if child == body:
            continue
        # Hinges turn a body about an anchor, which moves its frame by up to twice the anchor's
        # distance.
        anchors = model.jnt_pos[model.jnt_bodyid == child]
        offset = np.linalg.norm(model.body_pos[child])
        offset = offset + 2.0 * np.linalg.norm(anchors, axis=-1).sum()
        radii.append(offset + _extent(model, int(child)))
    return float(max(radii))


def _bounded_static_bodies(model: mujoco.MjModel) -> np.ndarray:
    """List the ids of static bodies that can collide and have bounds, which planes do not."""
    planes = model.geom_bodyid[model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE]
    collides = (model.body_contype | model.body_conaffinity) != 0
    mask = (model.body_weldid == 0) & collides & (model.body_geomnum > 0)
    mask[planes] = False
    # The exclusion of a single body takes longer than it saves.
    if mask.sum() <= 1:
        return np.empty(0, int)
    return np.flatnonzero(mask)


def _bounds(model: mujoco.MjModel, data: mujoco.MjData, body: int) -> tuple[np.ndarray, np.ndarray]:
    """Compute lowest and highest x and y of the box around a body's geoms, [2] m each."""
    first = model.body_geomadr[body]
    geoms = slice(first, first + model.body_geomnum[body])
    rotation = data.geom_xmat[geoms].reshape(-1, 3, 3)
    # Centre and half sizes of each geom's own box, in its frame and then in the world's.
    centre = model.geom_aabb[geoms, :3]
    half_size = model.geom_aabb[geoms, 3:]
    middle = data.geom_xpos[geoms] + np.einsum("gij,gj->gi", rotation, centre)
    reach = np.einsum("gij,gj->gi", np.abs(rotation), half_size) + model.geom_margin[geoms, None]
    low = (middle - reach).min(0)[:2]
    high = (middle + reach).max(0)[:2]
    return low, high
