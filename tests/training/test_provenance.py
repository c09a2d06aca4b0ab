"""What a checkpoint, which may be a stranger's, can set of the run that resumes it."""

import math

import pytest

from renet.errors import RenetError
from renet.training.provenance import restore, to_json
from renet.training.train import TrainCfg

TASK = "Renet-Go1-Parkour"


@pytest.fixture(scope="module")
def registered():
    return TrainCfg.from_task(TASK)


@pytest.fixture
def stored(registered):
    return {"agent": to_json(registered.agent), "env": to_json(registered.env)}


def put(settings: dict, name: str, value) -> None:
    """Set what a dotted name stands for."""
    *path, last = name.split(".")
    for key in path:
        settings = settings[key]
    settings[last] = value


def get(cfg, name: str):
    """What a dotted name stands for in a configuration."""
    for key in name.split("."):
        cfg = cfg[key] if isinstance(cfg, dict) else getattr(cfg, key)
    return cfg


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("agent.logger", "wandb"),
        ("agent.wandb_project", "mine"),
        ("agent.upload_model", True),
        ("agent.run_name", "../../elsewhere"),
        ("env.sim.nan_guard.enabled", True),
        ("env.sim.nan_guard.output_dir", "/etc"),
        ("env.sim.mujoco.gravity", [0.0, 0.0, -1e30]),
        ("env.viewer.width", 10**9),
        # As checkpoints of before have it; there are none any more.
        ("env.scene.entities.robot.collisions", [{"geom_names_expr": [".*"]}]),
    ],
)
def test_what_is_not_of_the_policy_stays(registered, stored, name, value):
    put(stored, name, value)
    part = name.split(".")[0]
    cfg = restore(getattr(registered, part), stored[part], part)
    assert to_json(cfg) == to_json(getattr(registered, part))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("env.scene.num_envs", 10**9),
        ("env.scene.num_envs", 0),
        ("env.scene.terrain.terrain_generator.num_rows", 10**6),
        ("env.scene.terrain.terrain_generator.sub_terrains.obstacles.count", 10**8),
        ("env.sim.njmax", 10**9),
        ("env.sim.mujoco.timestep", 0.0),
        ("env.sim.mujoco.iterations", 10**9),
        ("env.rewards.yaw.weight", math.inf),
        ("env.rewards.yaw.weight", math.nan),
        ("agent.model.history", 10**7),
        ("agent.model.critic_hidden", [256, 10**9]),
        ("agent.num_steps_per_env", 10**9),
        ("agent.keep_checkpoints", 10**9),
    ],
)
def test_numbers_out_of_bounds_are_named(registered, stored, name, value):
    put(stored, name, value)
    part = name.split(".")[0]
    with pytest.raises(RenetError, match=f"setting {name} is .* must be from"):
        restore(getattr(registered, part), stored[part], part)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("env.scene.num_envs", 64),
        ("env.rewards.yaw.weight", 0.25),
        ("env.sim.njmax", 600),
        ("env.commands.goal.speed", [0.1, 0.7]),
        ("agent.algorithm.entropy", "0.003@10M,0.001@60M"),
        ("agent.model.history", 1),
        # These are None in the task.
        ("agent.num_steps_per_env", 40),
        ("env.motors.no_load_speed", [0.9, 1.4]),
        ("env.motors.model", "go1"),
    ],
)
def test_what_shapes_the_policy_comes_back(registered, stored, name, value):
    put(stored, name, value)
    part = name.split(".")[0]
    cfg = restore(getattr(registered, part), stored[part], part)
    got = get(cfg, name.split(".", 1)[1])
    assert (list(got) if isinstance(got, tuple) else got) == value


def test_a_schedule_comes_back_where_the_task_has_none():
    """The paper's task has no limit of the noise; a text that is no schedule may be a path."""
    paper = TrainCfg.from_task(f"{TASK}-Paper").agent
    assert paper.algorithm.max_std is None
    for value, expected in (("0.5@12M,0.2@40M", "0.5@12M,0.2@40M"), ("../elsewhere", None)):
        stored = to_json(paper)
        put(stored, "algorithm.max_std", value)
        assert restore(paper, stored, "agent").algorithm.max_std == expected
