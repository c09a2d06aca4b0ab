"""The simulated environment: tiles, twins, and physical faults, which change rays alone."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from renet.bundle import Bundle
from renet.deploy.robots.base import RobotState
from renet.deploy.safety.limits import SafetyCfg, limited_command
from renet.errors import RenetError
from renet.evaluation.env import SimEnv, study_env_cfg
from renet.evaluation.rollout import Trial
from renet.faults import Injection, ViewPerturbation
from renet.robots import GO1
from renet.selector import SelectorSpec, make_selector
from renet.tasks import mdp
from renet.tasks.parkour_env_cfg import flat_env_cfg, tile_env_cfg
from renet.tasks.sensors import HEIGHT_MAP, depth_camera
from renet.tasks.terrains import tile_row
from renet.terrain.tiles import LEVELS, TILE, tiles

from .fakes import FakePolicy, fake_rollout


def quiet(task, robots: int) -> SimEnv:
    """Twins in a study's world whose cameras have no noise and a nominal mount."""
    cfg = study_env_cfg(task, 0.5)
    camera = depth_camera(cfg)
    camera.noise.relative_std = camera.noise.gaussian_std = 0.0
    camera.mount = replace(camera.mount, position_error=0.0, angle_error=0.0)
    return SimEnv(cfg, [0] * robots, 3, "native")


@pytest.fixture(scope="module")
def tile():
    return quiet(tile_env_cfg(tile_row({"platform": 8}), play=True), 4)


def seen(world: SimEnv, **rows: dict[int, object]) -> np.ndarray:
    """Images after a reset; a perturbation of some robots' cameras is given by its fields."""
    view = ViewPerturbation.none(world.num_robots)
    for name, values in rows.items():
        for row, value in values.items():
            getattr(view, name)[row] = value
    world.perturb_cameras(view)
    depth = world.reset().depth.astype(np.float32)
    world.perturb_cameras(ViewPerturbation.none(world.num_robots))
    return depth


def test_foam_brings_flat_ground_nearer_by_its_height_and_nothing_there_is_glass():
    flat = quiet("Renet-Go1-Flat", 2)
    # A plane is the same everywhere.
    flat.place_on(["flat", "flat"])
    depth = seen(flat, lift={1: 0.1})
    eye = flat.env.sim.data.qpos[0, 2].item() + 0.03  # The head is level with the trunk, about.
    both = (depth < 1.0).all(axis=0)
    ratio = depth[1][both] / depth[0][both]
    # Every ray that ends on the ground is shorter in the proportion of the eye's heights.
    assert ratio.std() < 0.01
    pitch = 0.27 * abs(flat.env.sim.data.qpos[0, 5].item())
    assert ratio.mean() == pytest.approx((eye - 0.1) / eye, abs=0.1 + pitch)
    assert 0.4 < ratio.mean() < 0.85
    with pytest.raises(RenetError, match="no obstacle that could be glass"):
        seen(flat, glass={0: 1.0})


def test_only_the_disturbed_robots_see_it_and_each_what_is_true(tile):
    true = seen(tile)
    depth = seen(tile, lift={1: 0.1}, turn={2: (0.0, 0.1, 0.0)}, glass={3: 1.0})
    np.testing.assert_array_equal(depth[0], true[0])
    assert ((np.abs(depth - true)[1:] > 0.02).mean(axis=(1, 2)) > 0.05).all()
    # Pitch is positive downwards: the picture's lower rows move up.
    shifts = [np.abs(depth[2][:40] - true[2][k : 40 + k]).mean() for k in range(9)]
    assert np.argmin(shifts) == pytest.approx(0.1 * 24.0 / 0.4875, abs=1.1)
    # Through glass, the ground behind.
    assert (depth[3] >= true[3] - 2e-3).all()
    assert (depth[3] > true[3] + 0.05).any()


def test_a_physical_fault_comes_and_goes_with_its_schedule(tile):
    foam = (Injection("foam", 0.15, onset=10, duration=0.2),)
    rows = [Trial("blind", foam), Trial("blind"), Trial("blind", foam), Trial("blind")]
    selector = make_selector("switch", SelectorSpec(beta=1.0), 4)
    rollout = fake_rollout(tile, FakePolicy(4), rows, memory=selector)
    film = rollout.run(30, film=[0, 1]).film
    gap = np.abs(film.images[:, 0].astype(float) - film.images[:, 1]).mean(axis=(1, 2))
    disturbed = gap > 5 * gap[:2].max() + 1
    np.testing.assert_array_equal(disturbed, [False, False, True, True, False, False])


def test_robots_stand_on_the_tiles_they_are_placed_on_and_obey_a_new_command():
    kinds, levels = np.array([4, 2, 3, 5]), np.array([0, 9, 4, 2])
    world = SimEnv(study_env_cfg("Renet-Go1-Parkour", 0.5), range(4), 1, "auto")
    world.place(levels, kinds)
    result = world.reset()
    height = world.env.scene["robot"].data.root_link_pos_w[:, 2] - world.env.scene.env_origins[:, 2]
    assert ((height > 0.2) & (height < 0.4)).all()
    np.testing.assert_allclose(result.proprioception[:, 6], 0.5)
    position = world.env.scene["robot"].data.root_link_pos_w.numpy()
    # Rows of the terrain lie along x, columns along y, one tile apart.
    order = np.argsort(levels)
    np.testing.assert_allclose(np.diff(position[order, 0]), TILE * np.diff(levels[order]), atol=0.7)
    rise = tiles()["stairs_up"].measure_at(LEVELS)
    assert position[1, 2] < -5 * rise
    world.command(0.0)
    for _ in range(5):
        result = world.step(np.zeros((4, 12), np.float32))
    np.testing.assert_allclose(result.proprioception[:, 6], 0.0)
    assert not result.ended.any()
    assert result.travelled.max() < 0.3


def test_the_map_of_a_taller_robot_is_drawn_where_its_ground_is():
    cfg = study_env_cfg(flat_env_cfg(play=True, robot=replace(GO1, map_height=0.38)), 0.5)
    world = SimEnv(cfg, range(2), 1, "native")
    world.reset()
    heights = world.poses([0, 1])[:, 2, None]
    sensed = world.env.scene[HEIGHT_MAP].data.numpy().copy()
    selector = make_selector("memory", SelectorSpec(beta=0.01), 2)
    rollout = fake_rollout(world, FakePolicy(2), [Trial("camera")] * 2, memory=selector)
    film = rollout.run(1, film=[0, 1]).film
    assert film is not None
    # The plane is at the height 0.
    np.testing.assert_allclose(heights - film.map_height - sensed, 0.0, atol=1e-3)


def test_retired_robots_stand_still_until_the_next_reset_and_the_others_walk_alike():
    world = SimEnv(study_env_cfg("Renet-Go1-Parkour", 0.5), range(3), 1, "native")
    random = np.random.default_rng(0)
    actions = random.normal(0.0, 0.5, (30, 3, 12)).astype(np.float32)

    def walk(retire: int | None) -> list:
        results = [world.reset()]
        for step, action in enumerate(actions):
            if step == retire:
                world.retire(np.array([True, False, True]))
            results.append(world.step(action))
        return results

    whole, left, again = walk(None), walk(12), walk(None)
    for one, other, third in zip(whole, left, again, strict=True):
        for name in ("proprioception", "depth", "travelled", "power"):
            values, others = getattr(one, name), getattr(other, name)
            np.testing.assert_array_equal(values[1], others[1], name)
            np.testing.assert_array_equal(values, getattr(third, name), name)
    np.testing.assert_array_equal(left[-1].travelled[[0, 2]], left[12].travelled[[0, 2]])
    assert (whole[-1].travelled[[0, 2]] != left[-1].travelled[[0, 2]]).all()


def test_targets_are_those_that_deploy_would_send():
    world = quiet("Renet-Go1-Flat", 2)
    world.reset()
    action = world.env.action_manager.get_term("joint_pos")
    robot = Bundle.load().manifest.robot
    safety = SafetyCfg()
    at_rest = RobotState(0.0, *np.zeros((3, 12)), np.array([1.0, 0, 0, 0]), np.zeros(3))
    sent = np.array(robot.default_position)
    draw = np.random.default_rng(2)
    for _ in range(20):
        wanted = draw.uniform(-4.8, 4.8, (2, 12)).astype(np.float32)
        action.process_actions(torch.from_numpy(wanted))
        target = np.array(robot.default_position) + robot.action_scale * wanted[0]
        sent = limited_command(target, sent, at_rest, robot, safety.target_rate).position
        assert action._processed_actions[0].numpy() == pytest.approx(sent, abs=1e-5)
    # The last actions were beyond what is sent, and are what policies observe.
    assert action.raw_action[0].numpy() == pytest.approx(wanted[0])
    assert np.abs(target - sent).max() > 0.1


@pytest.mark.parametrize(
    ("field", "column", "value"),
    [("qpos", 9, 3.0), ("qvel", 6, -61.0), ("qvel", 5, 31.0)],
    ids=["joint beyond its range", "joint too fast", "base turns too fast"],
)
def test_a_robot_that_deploy_would_brake_has_fallen(field, column, value):
    world = quiet("Renet-Go1-Flat", 2)
    world.reset()
    assert not world.step(np.zeros((2, 12), np.float32)).fell.any()
    getattr(world.env.sim.data, field)[1, column] = value
    world.env.sim.forward()
    safety = SafetyCfg()
    limits = safety.joint_margin, safety.max_joint_speed, safety.max_turn_rate
    assert mdp.beyond_limits(world.env, *limits).tolist() == [False, True]
