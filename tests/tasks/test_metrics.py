"""What is logged beside the rewards."""

import pytest
import torch

from renet.interface import HEIGHT_MAP_X, HEIGHT_MAP_Y
from renet.tasks import mdp
from renet.tasks.parkour_env_cfg import flat_env_cfg, tile_env_cfg
from renet.tasks.terrains import tile_row

from .conftest import evaluate


def test_clipped_rewards_and_costs_are_logged(flat):
    flat.reward_manager.get_term_cfg("action_rate").weight = -100.0
    rewards = [flat.step(torch.full((4, 12), 4.8 * (n < 1)))[1].clone() for n in range(3)]
    flat.reward_manager.get_term_cfg("action_rate").weight = -0.1
    logged = flat.metrics_manager.reset()
    negative = (torch.stack(rewards) < 0.0).float().mean()
    assert negative > 0.5
    assert logged["Episode_Metrics/reward_clipped"] == pytest.approx(negative)
    assert logged["Episode_Metrics/cost_torque"] > 0.0
    assert logged["Episode_Metrics/cost_joint_position"] >= 0.0


@pytest.mark.parametrize("weight", [0.0, -2.0])
def test_reward_without_weight_is_logged(build, weight):
    cfg = flat_env_cfg()
    cfg.rewards["linear_velocity"].weight = weight
    env = build(cfg, 2)
    env.sim.data.qvel[:, :2] = 0.3
    env.reward_buf = env.reward_manager.compute(dt=0.02)
    expected = evaluate(env, "linear_velocity")
    assert (expected != 0.0).all()
    torch.testing.assert_close(mdp.reward_term(env, "linear_velocity"), expected)


def test_edge_is_relief_nearby(parkour):
    maps = torch.zeros(12, len(HEIGHT_MAP_X), len(HEIGHT_MAP_Y))
    ahead, aside = HEIGHT_MAP_X.index(0.45), HEIGHT_MAP_Y.index(-0.45)
    maps[0, ahead, 5] = -0.1  # A step ahead.
    maps[1, 0, aside] = 0.1  # A pit to the side.
    maps[2, ahead, 5] = 0.07  # Too low.
    maps[3, ahead + 1, 5], maps[4, 3, aside - 1] = 0.5, 0.5  # Too far.
    maps[5] = 0.3  # A robot in the air over flat ground.
    parkour.obs_buf["height_map"] = maps.flatten(1)
    assert mdp.near_edge(parkour).tolist() == [1.0, 1.0] + 10 * [0.0]


@pytest.mark.parametrize(("distance", "edge"), [(1.1, 1.0), (0.0, 0.0)])
def test_steps_near_edges_are_logged(build, distance, edge):
    cfg = tile_env_cfg(tile_row({"gap": 5}), play=True)
    cfg.events["spawn"].params["pose_range"] = {"x": (distance, distance), "z": (0.02, 0.02)}
    env = build(cfg, 2)
    for _ in range(3):
        env.step(torch.zeros(2, 12))
    assert env.metrics_manager.reset()["Episode_Metrics/near_edge"] == edge
