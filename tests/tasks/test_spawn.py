"""Where robots begin, on every tile at every level, and what happens to those that get lost."""

import mujoco
import pytest
import torch

from renet.tasks import env_cfg, make_env
from renet.terrain.tiles import LEVELS, tiles

KINDS = list(tiles())


@pytest.fixture(scope="module")
def everywhere():
    """One robot on every tile of the curriculum."""
    env = make_env(env_cfg("Renet-Go1-Parkour", play=True), LEVELS * len(KINDS))
    terrain = env.scene.terrain
    tile = torch.arange(env.num_envs)
    terrain.terrain_levels[:], terrain.terrain_types[:] = tile // len(KINDS), tile % len(KINDS)
    terrain.env_origins[:] = terrain.terrain_origins[terrain.terrain_levels, terrain.terrain_types]
    env.reset()
    yield env
    env.close()


def test_no_robot_begins_inside_the_ground(everywhere):
    model = everywhere.sim.mj_model
    data = mujoco.MjData(model)
    for seed in range(3):
        everywhere.reset(seed=seed)
        for robot, pose in enumerate(everywhere.sim.data.qpos.numpy()):
            data.qpos[:] = pose
            mujoco.mj_fwdPosition(model, data)
            for contact in data.contact:
                parts = " on ".join(model.geom(geom).name for geom in contact.geom)
                # Joints are drawn, too: a stretched leg may touch, as a foot in the grass does.
                assert contact.dist > -0.02, f"{parts}, {KINDS[robot % len(KINDS)]}, {robot}"


def test_robots_spawn_at_rest(everywhere):
    everywhere.step(torch.ones(everywhere.num_envs, 12))
    everywhere.reset(seed=5)
    robot = everywhere.scene["robot"].data
    offset = robot.root_link_pos_w - everywhere.scene.env_origins
    assert offset[:, :2].abs().max() <= 0.3 + 1e-4
    assert (offset[:, 2] > 0.27).all()
    quarters = torch.div(robot.heading_w + torch.pi, torch.pi / 2, rounding_mode="floor")
    assert set(quarters.int().tolist()) == {0, 1, 2, 3}
    bent = (robot.joint_pos - robot.default_joint_pos).abs()
    assert 0.09 < bent.max() <= 0.1 + 1e-6
    low, high = robot.soft_joint_pos_limits.unbind(-1)
    assert ((low <= robot.joint_pos) & (robot.joint_pos <= high)).all()
    assert (everywhere.sim.data.qvel[:] == 0.0).all()
    upright = torch.tensor([0.0, 0.0, -1.0]).expand(everywhere.num_envs, 3)
    torch.testing.assert_close(robot.projected_gravity_b, upright)


@pytest.mark.parametrize(
    ("kind", "position", "why"),
    [
        ("rough", (0.0, 4.5, 0.3), "left_tile"),
        ("rough", (60.0, 0.0, 0.3), "left_tile"),  # It is off the map.
        ("rough", (0.0, 0.0, -5.0), "below_map"),
        ("gap", (1.25, 0.0, -0.4), "in_gap"),
    ],
)
def test_lost_robot_returns_to_its_tile(everywhere, kind, position, why):
    """Leaving a tile alone is a time-out."""
    everywhere.reset(seed=1)
    lost = KINDS.index(kind)
    start = everywhere.scene.env_origins[lost] + torch.tensor(position)
    everywhere.sim.data.qpos[lost, :3] = start
    still = torch.zeros(everywhere.num_envs, 12)
    obs, reward, terminated, truncated, extras = everywhere.step(still)
    assert (terminated | truncated).nonzero().flatten().tolist() == [lost]
    assert (terminated[lost], truncated[lost]) == (why != "left_tile", why == "left_tile")
    assert extras["log"][f"Episode_Termination/{why}"] == 1
    assert all(value.isfinite().all() for value in (reward, *obs.values()))
    offset = everywhere.scene["robot"].data.root_link_pos_w - everywhere.scene.env_origins
    assert offset[lost, :2].abs().max() <= 0.3 + 1e-4


def test_every_kind_of_tile_logs_its_level(build):
    env = build("Renet-Go1-Parkour", 12)
    term = env.curriculum_manager.get_term_cfg("level").func
    term.levels[:] = env.scene.terrain.terrain_levels[:] = env.scene.terrain.terrain_types + 1
    env.command_manager.get_term("goal").commanded_distance[:] = 10.0
    env.episode_length_buf[:] = env.max_episode_length
    *_, extras = env.step(torch.zeros(12, 12))
    logged = {name: extras["log"][f"Curriculum/level/{name}"] for name in KINDS}
    # Robots that stood when they were to walk move down a level.
    assert [logged[name] for name in KINDS] == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
