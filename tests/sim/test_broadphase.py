"""What MuJoCo Warp's broad phases visit in the parkour scene, of which a GPU times one."""

import mujoco
import mujoco_warp
import numpy as np
import pytest
import warp as wp

from renet.tasks import make_env

DIRECTION = np.array([0.5935, 0.7790, 0.1235])
"""Along which MuJoCo Warp sweeps."""


@pytest.fixture(scope="module")
def scene():
    env = make_env("Renet-Go1-Parkour", 2)
    env.reset()
    model, data = env.sim.mj_model, mujoco.MjData(env.sim.mj_model)
    data.qpos[:] = env.sim.data.qpos[0].numpy()
    data.qpos[2] -= 0.1  # The feet are in the ground.
    mujoco.mj_forward(model, data)
    yield model, data, env.sim.wp_model
    env.close()


def swept_pairs(model: mujoco.MjModel, data: mujoco.MjData) -> int:
    """Pairs of geoms whose bounding spheres overlap along the direction of the sweep."""
    centre = data.geom_xpos @ (DIRECTION / np.linalg.norm(DIRECTION))
    radius = np.where(model.geom_rbound > 0, model.geom_rbound, np.inf) + model.geom_margin
    lowest = np.sort(centre - radius)
    highest = (centre + radius)[np.argsort(centre - radius)]
    begun = np.searchsorted(lowest, highest, side="right")
    return int((begun - np.arange(model.ngeom) - 1).sum())


def test_sweep_visits_more_pairs(scene):
    model, data, wp_model = scene
    assert wp_model.opt.broadphase == mujoco_warp.BroadphaseType.NXN
    assert swept_pairs(model, data) > 2 * len(wp_model.nxn_geom_pair_filtered)


def contacts(model: mujoco.MjModel, data: mujoco.MjData, broadphase: int) -> np.ndarray:
    """Geoms and distance of each contact, sorted, [contacts, 3]."""
    wp_model = mujoco_warp.put_model(model)
    wp_model.opt.broadphase = broadphase
    wp_data = mujoco_warp.put_data(model, data, nconmax=500, njmax=400)
    mujoco_warp.kinematics(wp_model, wp_data)
    mujoco_warp.collision(wp_model, wp_data)
    count = int(wp_data.nacon.numpy()[0])
    geoms = wp_data.contact.geom.numpy()[:count]
    distance = wp_data.contact.dist.numpy()[:count, None]
    rows = np.concatenate((geoms, distance), axis=1)
    return rows[np.lexsort(rows.T[::-1])]


def test_both_find_the_same_contacts(scene):
    model, data, _ = scene
    with wp.ScopedDevice("cpu"):
        kinds = mujoco_warp.BroadphaseType
        tried = contacts(model, data, kinds.NXN)
        swept = contacts(model, data, kinds.SAP_SEGMENTED)
    assert len(tried) > 0
    np.testing.assert_allclose(swept, tried, atol=1e-6)
