"""One small environment of each of the paper's tasks, shared by all tests of a module."""

import math
from collections.abc import Callable

import pytest
import torch

from renet.tasks import RenetEnv, env_cfg, make_env
from renet.tasks.mdp.commands import GoalCommand
from renet.tasks.parkour_env_cfg import flat_env_cfg


@pytest.fixture(scope="module")
def shared_flat() -> RenetEnv:
    cfg = flat_env_cfg()
    cfg.rewards = env_cfg("Renet-Go1-Flat").rewards | cfg.rewards  # The recipe's, too.
    return make_env(cfg, 4)


@pytest.fixture(scope="module")
def shared_parkour() -> RenetEnv:
    return make_env("Renet-Go1-Parkour-Paper", 12)


@pytest.fixture
def flat(shared_flat) -> RenetEnv:
    shared_flat.reset()
    return shared_flat


@pytest.fixture
def parkour(shared_parkour) -> RenetEnv:
    shared_parkour.reset()
    return shared_parkour


@pytest.fixture
def goal(flat) -> GoalCommand:
    return flat.command_manager.get_term("goal")


@pytest.fixture
def build(request) -> Callable[..., RenetEnv]:
    """As `make_env`, in which robots stand, until the end of a test."""

    def make(*args, **options) -> RenetEnv:
        env = make_env(*args, **options)
        request.addfinalizer(env.close)
        env.reset()
        return env

    return make


def evaluate(env: RenetEnv, name: str) -> torch.Tensor:
    """A reward of the present state, before its weight, [N]."""
    cfg = env.reward_manager.get_term_cfg(name)
    return cfg.func(env, **cfg.params)


def scatter(env: RenetEnv, generator: torch.Generator) -> None:
    """Put robots anywhere, in any motion, touching anything, under any command."""

    def draw(*shape: int) -> torch.Tensor:
        return torch.randn(shape, generator=generator)

    count, data, goal = env.num_envs, env.sim.data, env.command_manager.get_term("goal")
    robot = env.scene["robot"]
    position = 1.5 * draw(count, 3) + env.scene.env_origins
    turn = 0.6 * draw(count, 4) + torch.tensor([1.0, 0.0, 0.0, 0.0])
    joints = robot.data.default_joint_pos + 0.4 * draw(count, 12)
    data.qpos[:] = torch.cat((position, turn / turn.norm(dim=-1, keepdim=True), joints), dim=-1)
    data.qvel[:] = 12.0 * draw(count, 18)
    env.sim.forward()
    env.scene.update(0.02)
    data.sensordata[:] = draw(*data.sensordata.shape).clamp_min(0.0).floor()
    data.qfrc_actuator[:] = draw(count, 18)
    env.action_manager.process_action(draw(count, 12))
    robot.set_joint_position_target(draw(count, 12))
    goal.speed[:] = draw(count).clamp(0.0, 1.0)
    goal.yaw[:] = draw(count).clamp(-math.pi, math.pi)
