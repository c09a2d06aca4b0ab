"""Memories of mirrored robots, beside those of the robots themselves."""

from types import SimpleNamespace

import pytest
import torch
from tensordict import TensorDict

from renet.errors import RenetError
from renet.models.symmetry import Mirror
from renet.tasks.mdp.commands import GoalCommandCfg
from renet.training.config import NP3OCfg, WithholdingCfg

from .conftest import ToyEnv, collect, make_runner


class Mirrors(ToyEnv):
    """Robots of which every second one is the mirror image of the one before."""

    def get_observations(self) -> TensorDict:
        obs = super().get_observations()
        mirror = Mirror("cpu")
        obs["proprioception"][1::2] = mirror.proprioception(obs["proprioception"][::2])
        obs["depth"][1::2] = mirror.image(obs["depth"][::2])
        obs["difficult"][1::2] = obs["difficult"][::2] = (torch.arange(4) % 2).float()[:, None]
        return obs

    def step(self, actions):
        obs, reward, done, extras = super().step(actions)
        done[1::2] = done[::2]
        return obs, reward, done, extras


def test_a_robot_in_the_mirror_is_remembered_as_its_mirror_image():
    env = Mirrors()
    algorithm = NP3OCfg(num_learning_epochs=1, mirror_loss=1.0)
    alg = make_runner(env, algorithm=algorithm, withholding=WithholdingCfg(share=0.0)).alg
    for iteration in (0, alg.adaptation.period):  # VP and OP on simple terrain.
        alg.iteration = iteration
        collect(alg, env, steps=40)
        latent, mirrored = alg._rollout.latent, alg._rollout.mirrored_latent
        assert alg._rollout.done.any()
        torch.testing.assert_close(mirrored[:, ::2], latent[:, 1::2])
        torch.testing.assert_close(mirrored[:, 1::2], latent[:, ::2])
        assert (latent[:, ::2] != latent[:, 1::2]).any()
        assert alg.update()["mirror"] > 0.0


def test_without_the_loss_no_second_memory_runs():
    env = ToyEnv()
    alg = make_runner(env).alg
    collect(alg, env)
    assert alg.mirrored_memory is None
    assert alg._rollout.mirrored_latent.numel() == 0
    assert "mirror" not in alg.update()


def test_a_loss_needs_twists():
    """In the mirror a heading would lie behind the robot that it lies ahead of."""
    env = ToyEnv()
    env.cfg = SimpleNamespace(commands={"goal": GoalCommandCfg(told="heading")})
    make_runner(env)
    with pytest.raises(RenetError, match="needs robots that are told twists"):
        make_runner(env, algorithm=NP3OCfg(mirror_loss=0.3))
    env.cfg.commands["goal"].told = "twist"
    make_runner(env, algorithm=NP3OCfg(mirror_loss=0.3))
