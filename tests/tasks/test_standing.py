"""The paper's two levels of commands, and standing still: asked for, seen, and rewarded."""

import pytest
import torch

from renet.cli import main
from renet.errors import RenetError
from renet.interface import proprioception_slices
from renet.tasks import make_env, mdp
from renet.training.train import TrainCfg


def test_the_second_level_begins_at_its_switch_point(flat):
    command, term = flat.command_manager.get_term("goal"), mdp.command_stage
    everyone = torch.arange(4)
    assert flat.cfg.curriculum["command_stage"].params["switch_step"] > 0
    for step, stage in ((0, 0), (99, 0), (100, 1), (5000, 1)):
        flat.common_step_counter = step
        assert term(flat, everyone, switch_step=100) == stage
        assert command.stage == stage
    # Going back, as after loading another checkpoint, is that checkpoint's business.
    flat.common_step_counter = 0
    assert term(flat, everyone, switch_step=100) == 1
    command.stage = 0


def test_the_switch_points_are_options_of_training(monkeypatch):
    asked = []

    def refuse(task, *_):
        terms = task.curriculum
        asked.append([terms["command_stage"].params["switch_step"], terms["level"].params])
        raise RenetError("that is all")

    monkeypatch.setattr("renet.tasks.make_env", refuse)
    command = ["train", "Renet-Go1-Parkour", "--num-envs", "100"]
    later = ["--standing-after", "30000", "--easier-after", "40000"]
    assert main(command) == main([*command, *later]) == 2
    assert main([*command, "--easier-after", "None"]) == 2
    default = TrainCfg(task="")
    assert asked == [
        [
            default.standing_after / 100,
            {"easier_step": default.easier_after / 100, "easier_kinds": ("gap",)},
        ],
        [300, {"easier_step": 400, "easier_kinds": ("gap",)}],
        [default.standing_after / 100, {}],
    ]


def test_a_robot_that_stands_as_asked_is_paid_nearly_all_there_is():
    env = make_env("Renet-Go1-Flat", 4, play=True)
    env.reset()
    command = env.command_manager.get_term("goal")
    command.speed[:] = torch.tensor([0.0, 0.0, 0.5, 0.5])
    command.yaw[:] = env.scene["robot"].data.heading_w
    env.sim.data.qvel[:] = 0.0
    for _ in range(50):
        obs, reward, *_ = env.step(torch.zeros(4, 12))
    # 1.5 for not moving and 0.5 for the heading, each times 0.02 s; no penalty is worth naming.
    assert (reward[:2] > 0.9 * 2.0 * 0.02).all()
    assert (reward[2:] < 0.3 * 2.0 * 0.02).all()
    told = obs["proprioception"][:, proprioception_slices()["command"]]
    assert told[:, 0].tolist() == pytest.approx([0.0, 0.0, 0.5, 0.5])
    env.close()
