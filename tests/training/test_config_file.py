"""`--config`: the task, what a file says of it, and what the command line says last."""

import json

import numpy as np
import pytest

from renet.cli import parse
from renet.errors import RenetError
from renet.training.provenance import to_json
from renet.training.train import TrainCfg

TASK = "Renet-Go1-Flat"


def run_of(*arguments: str) -> TrainCfg:
    """The settings of a command line."""
    return parse(TrainCfg, [*arguments], "renet train")


def written(cfg: TrainCfg) -> dict:
    """What a run writes into its config.json."""
    parts = to_json({"agent": cfg.agent, "env": cfg.env})
    return {"task": cfg.task, **parts, "code": "0.1.0"}


@pytest.fixture
def file(tmp_path):
    """Writes a configuration and returns the option for it."""

    def write(settings) -> list[str]:
        path = tmp_path / "config.json"
        path.write_text(json.dumps(settings))
        return ["--config", str(path)]

    return write


def test_what_a_run_wrote_gives_the_same_run(file):
    asked = ["--agent.algorithm.lam", "0.7", "--env.rewards.yaw.weight", "0.25", "--seed", "7"]
    asked += ["--env.motors.no-load-speed", "(0.9,1.4)"]
    first = run_of(TASK, *asked, "--num-envs", "24")
    again = run_of(*file(written(first)))
    assert written(again) == written(first)
    assert written(again) != written(run_of(TASK))
    assert again.env.rewards["yaw"].func is first.env.rewards["yaw"].func


def test_a_task_yields_to_a_file_and_a_file_to_the_command_line(file):
    algorithm = {"lam": 0.7, "gamma": 0.98}
    part = {"num_envs": 24, "agent": {"algorithm": algorithm, "seed": 5}}
    cfg = run_of(TASK, *file(part), "--agent.algorithm.gamma", "0.95", "--num-envs", "8")
    assert (cfg.agent.algorithm.lam, cfg.agent.algorithm.gamma) == (0.7, 0.95)
    assert (cfg.env.scene.num_envs, cfg.agent.seed) == (8, 5)
    assert run_of(TASK, *file(part)).env.scene.num_envs == 24
    untouched = TrainCfg.from_task(TASK).agent.algorithm.num_mini_batches
    assert cfg.agent.algorithm.num_mini_batches == untouched


def test_a_part_of_another_tasks_run_leaves_its_name_there(file):
    part = {"agent": written(run_of(TASK, "--seed", "7"))["agent"]}
    cfg = run_of("Renet-Go2-Flat", *file(part))
    assert cfg.agent.seed == 7
    assert cfg.task == cfg.agent.task == cfg.agent.experiment_name == "Renet-Go2-Flat"
    part["agent"]["experiment_name"] = "mine"
    assert run_of("Renet-Go2-Flat", *file(part)).agent.experiment_name == "mine"


def test_schedules_and_lists_are_set(file):
    part = {
        "agent": {"algorithm": {"entropy": "0.01@1M,0.002@5M", "cost_budget": [0.1, 0.2, "1@5M"]}},
        "env": {"motors": {"target_delay": [0.0, 0.02]}},
    }
    cfg = run_of(TASK, *file(part))
    assert cfg.agent.algorithm.entropy == "0.01@1M,0.002@5M"
    assert cfg.agent.algorithm.cost_budget == (0.1, 0.2, "1@5M")
    assert cfg.env.motors.target_delay == (0.0, 0.02)


def test_own_ground_comes_back(file, tmp_path):
    np.save(tmp_path / "map.npy", np.zeros((9, 9)))
    scene = ["--scene", str(tmp_path / "map.npy"), "--scene-share", "0.25"]
    first = run_of("Renet-Go1-Parkour", *scene)
    again = run_of(*file(written(first)))
    assert written(again) == written(first)
    tiles = again.env.scene.terrain.terrain_generator.sub_terrains
    total = sum(tile.proportion for tile in tiles.values())
    assert tiles["own"].proportion / total == pytest.approx(0.25)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"agents": {}}, "unknown setting 'agents': did you mean agent"),
        ({"agent": {"algorithm": {"lamb": 1}}}, "did you mean agent.algorithm.lam"),
        ({"agent": {"algorithm": {"lam": "much"}}}, "agent.algorithm.lam cannot be 'much'"),
        ({"agent": {"precision": "float64"}}, "agent.precision cannot be 'float64'"),
        ({"agent": {"algorithm": 3}}, "agent.algorithm must map names to values"),
        ({"env": {"rewards": {"yaw": {"func": "os.system"}}}}, "yaw.func cannot be changed"),
        ({"env": {"rewards": {"yaws": {}}}}, "did you mean env.rewards.yaw"),
        ({"env": {"scene": {"sensors": []}}}, "env.scene.sensors must list 7 items"),
        ({"num_envs": "many"}, "num_envs cannot be 'many'"),
        ({"task": "Renet-Go2-Flat"}, "is of the task Renet-Go2-Flat: train that"),
        ({"agent": {"algorithm": {"num_learning_epochs": 0}}}, "must be at least 1"),
    ],
)
def test_what_a_task_has_not_is_told_by_its_name(file, settings, message):
    with pytest.raises(RenetError, match=message) as told:
        run_of(TASK, *file(settings))
    assert "\n" not in str(told.value)
