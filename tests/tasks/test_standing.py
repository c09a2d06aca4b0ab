"""The paper's two levels of commands, and standing still: asked for, and rewarded."""

import pytest
import torch

from renet.errors import RenetError
from renet.tasks import env_cfg, make_env, mdp
from renet.tasks.parkour_env_cfg import flat_env_cfg
from renet.training.recipe import follow


def test_second_stage_begins_after_steps(flat, goal):
    term, everyone = mdp.command_stage, torch.arange(4)
    for step, stage in ((0, 0), (99, 0), (100, 1), (5000, 1)):
        flat.common_step_counter = step
        assert term(flat, everyone, after=400) == stage
        assert goal.stage == stage
    flat.common_step_counter = 3750
    term(flat, everyone, after=400, standing_time="0.4@10k,1@20k")
    assert goal.standing_time == pytest.approx(0.7)
    # Going back, as after loading another checkpoint, is that checkpoint's business.
    flat.common_step_counter = 0
    assert term(flat, everyone, after=400) == 1
    goal.stage = 0


@pytest.mark.parametrize("processes", [1, 3])
def test_environment_steps_count_all_processes(flat, monkeypatch, processes):
    monkeypatch.setenv("WORLD_SIZE", str(processes))
    term = mdp.EnvironmentSteps(flat.cfg.curriculum["environment_steps"], flat)
    monkeypatch.setattr(flat, "common_step_counter", 100)
    assert term.count == 4 * 100 * processes
    term.count = 10_000
    flat.common_step_counter += 5
    assert term.count == 10_000 + 4 * 5 * processes == term(flat, torch.arange(4))


def test_reward_weight_follows_schedule(monkeypatch):
    cfg = flat_env_cfg()
    follow(cfg, "yaw", "1@1k,3@2k")
    assert cfg.rewards["yaw"].weight == 1.0
    env = make_env(cfg, 4)
    for steps, weight in ((0, 1.0), (1500, 2.0), (9000, 3.0)):
        env.common_step_counter = steps // 4
        env.curriculum_manager.compute(torch.arange(4))
        assert env.reward_manager.get_term_cfg("yaw").weight == weight
    env.close()
    cfg.rewards["yaw"].weight = 2.0
    with pytest.raises(RenetError, match=r"reward yaw is 2\.0, but its schedule begins with 1\.0"):
        make_env(cfg, 4)


def test_standing_as_commanded_is_rewarded(build):
    env = build(env_cfg("Renet-Go1-Flat", play=True), 4)
    command = env.command_manager.get_term("goal")
    command.speed[:] = torch.tensor([0.0, 0.0, 0.5, 0.5])
    command.yaw[:] = env.scene["robot"].data.heading_w
    env.sim.data.qvel[:] = 0.0
    for _ in range(50):
        _, reward, *_ = env.step(torch.zeros(4, 12))
    # 1.5 for not moving and 0.5 for the heading, each times 0.02 s; no penalty is worth naming.
    assert (reward[:2] > 0.9 * 2.0 * 0.02).all()
    assert (reward[2:] < 0.3 * 2.0 * 0.02).all()
