"""Collision culling: static bodies out of a robot's reach are kept out of collision detection.

C MuJoCo computes bounds of all geoms that can collide at every step. A robot on one tile of a large
terrain pays more for the other tiles than for its own dynamics. MuJoCo skips bodies whose collision
masks are zero. Those out of reach would not have made contact, so results are the same.
"""

import mujoco
import numpy as np

from renet.sim.native.copy_tables import FieldCopy

MASKS = ("body_contype", "body_conaffinity")
TRAVEL = 0.5
"""Distance in m beyond a robot's reach within which bodies stay collidable. Bodies are culled anew
when a robot has moved half of it; the steps of one call must not move it by the other half."""


class CollisionCulling:
    """Collision masks of each environment's bodies, zero for static bodies out of reach.

    Reach is computed from the positions of free-floating roots. In models with fixed bases, sliding
    joints or mocap bodies nothing is culled.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, num_envs: int) -> None:
        """Set up for a model, with its data after `mj_forward`."""
        self.masks = [np.tile(getattr(model, name), (num_envs, 1)) for name in MASKS]
        """Masks [N, nbody] of both kinds, which engine.cpp writes."""
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
        """The struct Culling of engine.cpp."""

    def load_masks(self, model: mujoco.MjModel) -> list[FieldCopy]:
        """Copies of the masks into a worker's model; empty if nothing is culled."""
        if not self.fields["bodies"]:
            return []
        return [FieldCopy(m, getattr(model, n)) for m, n in zip(self.masks, MASKS, strict=True)]


def _roots(model: mujoco.MjModel) -> tuple[list[int], list[float]]:
    """qpos addresses of the free joints, and reach of their trees, m; empty if it is unbounded."""
    free = model.jnt_type == mujoco.mjtJoint.mjJNT_FREE
    moving_trees = np.unique(model.body_rootid[model.jnt_bodyid])
    if (
        model.nmocap
        or (model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE).any()
        or free.sum() != len(moving_trees)
    ):
        return [], []
    bodies = model.jnt_bodyid[free].tolist()
    return model.jnt_qposadr[free].tolist(), [_extent(model, body) + TRAVEL for body in bodies]


def _extent(model: mujoco.MjModel, body: int) -> float:
    """Radius around a body's frame that contains its subtree at all joint angles, m."""
    first, count = model.body_geomadr[body], model.body_geomnum[body]
    geoms = range(first, first + count)
    radii = [np.linalg.norm(model.geom_pos[geom]) + model.geom_rbound[geom] for geom in geoms]
    children = np.flatnonzero(model.body_parentid == body)
    # Hinges turn a body about an anchor, which shifts its frame by twice the anchor's distance.
    joints = {child: model.jnt_pos[model.jnt_bodyid == child] for child in children}
    below = [
        np.linalg.norm(model.body_pos[child])
        + 2.0 * np.linalg.norm(joints[child], axis=-1).sum()
        + _extent(model, int(child))
        for child in children
        if child != body
    ]
    return float(max([0.0, *radii, *below]))


def _bounded_static_bodies(model: mujoco.MjModel) -> np.ndarray:
    """Ids of static bodies that can collide and have bounds, which planes do not."""
    owners = model.geom_bodyid
    planes = owners[model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE]
    colliding = (model.body_contype | model.body_conaffinity) != 0
    static = (model.body_weldid == 0) & colliding & (model.body_geomnum > 0)
    static[planes] = False
    # To cull a single body would cost more than it saves.
    return np.flatnonzero(static) if static.sum() > 1 else np.empty(0, int)


def _bounds(model: mujoco.MjModel, data: mujoco.MjData, body: int) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest x, y of the box around a body's geoms, [2] m each."""
    first = model.body_geomadr[body]
    geoms = slice(first, first + model.body_geomnum[body])
    rotation = data.geom_xmat[geoms].reshape(-1, 3, 3)
    centre, half = model.geom_aabb[geoms, :3], model.geom_aabb[geoms, 3:]
    middle = data.geom_xpos[geoms] + np.einsum("gij,gj->gi", rotation, centre)
    spread = np.einsum("gij,gj->gi", np.abs(rotation), half) + model.geom_margin[geoms, None]
    return (middle - spread).min(0)[:2], (middle + spread).max(0)[:2]
