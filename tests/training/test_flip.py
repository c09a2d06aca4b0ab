"""What an estimator remembers when the actor listens to the other, and what each is taught."""

import pytest
import torch

from renet.models.adaptation import op_mask
from renet.training.algorithm import RenetAlgorithm
from renet.training.config import SupervisionCfg

from .conftest import ToyEnv, make_runner

PERIOD = 20
SIMPLE, DIFFICULT = slice(0, 8, 2), slice(1, 8, 2)
"""Rows of the toy environment."""


def algorithm(iteration: int, **supervision) -> tuple[RenetAlgorithm, ToyEnv]:
    """The same untrained networks and the same observations each time."""
    env = ToyEnv()
    alg = make_runner(env, supervision=SupervisionCfg(**supervision)).alg
    alg.iteration = iteration
    return alg, env


def run(alg: RenetAlgorithm, env, steps: int, flip_at: int | None = None) -> list[torch.Tensor]:
    """What the actor read at every step, [8, 128] each; no episode ends."""
    read, obs = [], env.get_observations()
    for step in range(steps):
        if step == flip_at:
            alg.iteration += PERIOD
        alg.act(obs)
        read.append(alg._steps.newest["latent"].clone())
        obs = env.get_observations()
        reward, done = torch.zeros(8), torch.zeros(8, dtype=torch.long)
        alg.process_env_step(obs, reward, done, {"costs": torch.zeros(8, 3)})
    return read


def test_flip_finds_warm_memories():
    alg, env = algorithm(iteration=PERIOD - 1)
    steered_by_op, other = algorithm(iteration=PERIOD)
    read, always = run(alg, env, 11, flip_at=7), run(steered_by_op, other, 11)
    before, after = read[6], read[7]
    op, vp = slice(0, 64), slice(64, 128)
    assert (before[:, op] == 0).all()
    assert (before[:, vp] != 0).any()
    # Simple terrain listens to OP from the first step of iteration 20, in the middle of a tick,
    # and OP remembers all that happened while VP steered.
    assert torch.equal(after[SIMPLE], always[7][SIMPLE])
    assert (after[SIMPLE, vp] == 0).all()
    assert torch.equal(after[DIFFICULT], before[DIFFICULT])
    # Both memories went on, whoever was listened to.
    for name in ("latent_op", "latent_vp", "history", "frames"):
        memory = getattr(alg.memory, name)
        assert torch.equal(memory, getattr(steered_by_op.memory, name))
        assert memory.abs().sum() > 0


@pytest.mark.parametrize(
    ("iteration", "data", "taught"),
    [
        (0, "own", {"vp"}),
        (PERIOD, "own", {"op", "vp"}),  # Difficult terrain keeps VP's own set from being empty.
        (0, "all", {"op", "vp"}),
        (PERIOD, "all", {"op", "vp"}),
    ],
)
def test_estimator_data_is_own_or_all(iteration, data, taught):
    alg, env = algorithm(iteration, estimator_data=data)
    start = {name: value.clone() for name, value in alg.model.named_parameters()}
    run(alg, env, 10)
    alg.compute_returns(env.get_observations())
    alg.update()
    for name in ("op", "vp"):
        own = [n for n in start if n.startswith((f"{name}.", f"{name}_him."))]
        moved = any(not torch.equal(start[n], alg.model.get_parameter(n)) for n in own)
        assert moved == (name in taught)


def test_the_policy_gradient_stops_at_the_latent():
    alg, _ = algorithm(iteration=0)
    networks = (alg.model.actor, alg.model.critics)
    policy = {id(p) for network in networks for p in network.parameters()}
    supervised = {id(p) for p in alg.model.supervised_parameters()}
    assert not policy & supervised
    trained = {id(p) for group in alg.np3o.optimizer.param_groups for p in group["params"]}
    assert trained == policy


def test_difficult_terrain_keeps_vision():
    tiles = torch.tensor([[0.0], [1.0], [0.0]])
    for iteration, simple in ((0, False), (19, False), (20, True), (39, True), (40, False)):
        assert op_mask("renet", iteration, tiles, 20).tolist() == [simple, False, simple]
        # Ablations with a single estimator never alternate.
        assert op_mask("op", iteration, tiles, 20).all()
        assert not any(op_mask(p, iteration, tiles, 20).any() for p in ("vp", "oracle"))
