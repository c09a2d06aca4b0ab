"""Two ranks over gloo train one model: same parameters, and the joined batch's gradients."""

import json
import os
import socket
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from torch.multiprocessing.spawn import start_processes

from renet.training.np3o import make_targets
from renet.training.storage import PolicyRollout
from renet.training.train import train

from .. import forked  # noqa: F401  What processes begin with.
from .conftest import ToyEnv, make_runner
from .test_np3o import random_rollout, small
from .test_train import cfg

RANKS = 2


@pytest.fixture(scope="module")
def ranks(tmp_path_factory) -> list[dict]:
    """What each of two processes found."""
    folder = tmp_path_factory.mktemp("ranks")
    start(work, folder)
    assert len(list((folder / "checkpoints").iterdir())) == 1, "rank 0 alone writes"
    return [torch.load(folder / f"{rank}.pt") for rank in range(RANKS)]


def start(function: Callable[[int, Path], object], folder: Path) -> None:
    """Call a function as torchrun's processes would, with their rank and a folder."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    start_processes(_join, (function, folder, port), RANKS, start_method="forkserver")


def _join(rank: int, function: Callable[[int, Path], object], folder: Path, port: int) -> None:
    torch.set_num_threads(1)
    os.environ |= {
        "RANK": str(rank),
        "LOCAL_RANK": str(rank),
        "WORLD_SIZE": str(RANKS),
        "MASTER_ADDR": "127.0.0.1",
        "MASTER_PORT": str(port),
    }
    function(rank, folder)


def work(rank: int, folder: Path) -> None:
    """Gradients of half a batch, and the state after five iterations."""
    own = None if rank else folder
    runner = make_runner(ToyEnv(seed=rank), own, rank, num_steps_per_env=5, save_interval=9)
    runner.learn(5)
    data, last_value = rollout()
    mine = slice(4 * rank, 4 * rank + 4)
    half = PolicyRollout(**{name: value[:, mine] for name, value in vars(data).items()})
    found = {
        "model": runner.alg.model.state_dict(),
        "rate": runner.alg.np3o.learning_rate,
        "weight": runner.alg.np3o.cost_weight,
        "gradients": gradients(half, last_value[mine]),
    }
    torch.save(found, folder / f"{rank}.pt")


def run(rank: int, folder: Path) -> None:
    train(cfg(folder))


def rollout() -> tuple[PolicyRollout, torch.Tensor]:
    """Four steps of eight environments; a rank takes half of the environments."""
    torch.manual_seed(3)
    return random_rollout(small().actor, steps=4, robots=8)


def gradients(data: PolicyRollout, last_value: torch.Tensor) -> list[torch.Tensor]:
    torch.manual_seed(0)
    algorithm = small(max_grad_norm=1e9, desired_kl=0.0)
    targets = make_targets(data, last_value, algorithm.cfg)
    rows = torch.arange(data.log_prob.numel())
    algorithm._step(data.flatten(), targets, rows, algorithm.actor.log_std.detach().exp())
    return [parameter.grad for parameter in algorithm.parameters]


def test_ranks_agree_after_five_iterations(ranks):
    first, second = ranks
    assert first["rate"] == second["rate"]
    assert first["weight"] == second["weight"]
    for name, value in first["model"].items():
        torch.testing.assert_close(value, second["model"][name], atol=1e-6, rtol=1e-5, msg=name)


def test_gradients_equal_one_process_on_the_joined_batch(ranks):
    joined = gradients(*rollout())
    for a, b, c in zip(*(rank["gradients"] for rank in ranks), joined, strict=True):
        torch.testing.assert_close(a, b)
        torch.testing.assert_close(a, c, atol=1e-5, rtol=1e-3)


def test_a_run_of_two_processes_counts_both_ones_steps(tmp_path):
    start(run, tmp_path)
    (state,) = tmp_path.rglob("state.json")
    assert json.loads(state.read_text())["steps"] == RANKS * 4 * 5
