"""Two ranks over gloo train one model: same parameters, and the joined batch's gradients."""

import json
import os
import socket
from collections.abc import Callable
from copy import deepcopy
from pathlib import Path

import pytest
import torch
from rsl_rl.modules import EmpiricalNormalization
from torch.multiprocessing.spawn import start_processes

from renet.models.config import ModelCfg
from renet.models.renet import RENet
from renet.training import distributed, np3o
from renet.training.config import SupervisionCfg
from renet.training.storage import PolicyRollout
from renet.training.supervision import Supervision
from renet.training.train import train

from .. import forked  # noqa: F401  What processes begin with.
from ..waits import Waits
from .conftest import ToyEnv, make_runner
from .test_np3o import random_rollout, small
from .test_supervision import random_rollout as ticks_of_four_robots
from .test_train import cfg

RANKS = 2


@pytest.fixture(scope="module")
def ranks(tmp_path_factory) -> list[dict]:
    """What `work` found in each of two processes."""
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
    names = {"RANK": rank, "LOCAL_RANK": rank, "WORLD_SIZE": RANKS, "MASTER_PORT": port}
    os.environ |= {name: str(value) for name, value in names.items()}
    os.environ["MASTER_ADDR"] = "127.0.0.1"
    function(rank, folder)


def work(rank: int, folder: Path) -> None:
    """Write the state after five iterations, and what half of a batch brings."""
    writes = None if rank else folder
    runner = make_runner(ToyEnv(seed=rank), writes, rank, num_steps_per_env=5, save_interval=9)
    runner.learn(5)
    data, last_value = rollout()
    half = slice(4 * rank, 4 * rank + 4)
    data = PolicyRollout(**{name: value[:, half] for name, value in vars(data).items()})
    rates = {name: getattr(runner.alg.np3o, name) for name in ("learning_rate", "cost_weight")}
    learnt = runner.alg.model.state_dict() | rates
    found = {
        "learnt": learnt,
        "gradients": gradients(data, last_value[half]),
        "averaged": averaged(rank),
        "supervised": supervised(rank),
        "normalizer": normalizer([rows.chunk(RANKS)[rank] for rows in observations()]),
    }
    torch.save(found, folder / f"{rank}.pt")


def run(rank: int, folder: Path) -> None:
    train(cfg(folder))


def rollout() -> tuple[PolicyRollout, torch.Tensor]:
    """Four steps of eight environments; a rank takes half of the environments."""
    torch.manual_seed(3)
    return random_rollout(small(), steps=4, robots=8)


def gradients(data: PolicyRollout, last_value: torch.Tensor) -> list[torch.Tensor]:
    torch.manual_seed(0)
    algorithm = small(max_grad_norm=1e9, desired_kl=0.0)
    targets = np3o.make_targets(data, last_value, algorithm.cfg)
    rows = torch.arange(data.log_prob.numel())
    algorithm._step(data.flatten(), targets, rows, algorithm.actor.log_std.detach().exp())
    return [parameter.grad for parameter in algorithm.parameters]


def averaged(rank: int) -> tuple[list, list[str]]:
    """The mean of gradients of which only rank 0 has the second, and what was waited for."""
    parameters = [torch.nn.Parameter(torch.zeros(2)), torch.nn.Parameter(torch.zeros(3, 1))]
    parameters[0].grad = torch.full((2,), 1.0 + rank)
    if rank == 0:
        parameters[1].grad = torch.full((3, 1), 8.0)
    with Waits() as watch:
        distributed.average_gradients(parameters)
    return [parameter.grad for parameter in parameters], watch.waits


def supervised(rank: int) -> tuple[dict, dict]:
    """A model before and after a step to which rank 0 brings OP's ticks and rank 1 VP's."""
    torch.manual_seed(0)
    model = RENet(ModelCfg(), critic_size=5)
    supervision = Supervision(model, SupervisionCfg(num_mini_batches=1))
    rollout = ticks_of_four_robots()
    supervision.update(rollout)  # All learn, so that Adam would move all.
    before = deepcopy(model.state_dict())
    rollout.op_mask[:] = rank == 0
    rollout.has_image[:] = False
    supervision.update(rollout)
    return before, model.state_dict()


def observations() -> list[torch.Tensor]:
    """Two batches of six rows, far from zero, and apart from each other and between ranks."""
    torch.manual_seed(5)
    rows = 100.0 + torch.arange(12.0).unsqueeze(-1) * torch.rand(12, 3)
    return list(rows.chunk(2))


def normalizer(batches: list[torch.Tensor]) -> dict[str, torch.Tensor]:
    """The state of a normaliser that has learnt from all ranks' batches."""
    running = EmpiricalNormalization(3)
    for rows in batches:
        distributed.update_normalizer(running, rows)
    return running.state_dict()


def test_ranks_agree_after_five_iterations(ranks):
    first, second = [found["learnt"] for found in ranks]
    torch.testing.assert_close(first, second, atol=1e-6, rtol=1e-5)


def test_gradients_equal_those_of_one_process(ranks):
    first, second = [found["gradients"] for found in ranks]
    torch.testing.assert_close(first, second)
    torch.testing.assert_close(first, gradients(*rollout()), atol=1e-5, rtol=1e-3)


def test_missing_gradient_counts_as_zero(ranks):
    for found in ranks:
        (both, one), waits = found["averaged"]
        assert both.tolist() == [1.5, 1.5]
        assert one.tolist() == [[4.0]] * 3
        assert not waits


def test_ranks_learn_each_others_estimators(ranks):
    (before, first), (_, second) = [found["supervised"] for found in ranks]
    torch.testing.assert_close(first, second, atol=0.0, rtol=0.0)
    moved = {name.split(".")[0] for name, value in first.items() if not value.equal(before[name])}
    assert moved == {"op", "op_him", "vp", "vp_him"}


def test_normalizer_learns_from_all_ranks(ranks):
    one_process = EmpiricalNormalization(3)
    for rows in observations():
        one_process.update(rows)
    for found in ranks:
        torch.testing.assert_close(
            found["normalizer"], one_process.state_dict(), atol=1e-5, rtol=1e-5
        )


def test_steps_of_two_processes_are_added(tmp_path):
    start(run, tmp_path)
    (state,) = tmp_path.rglob("state.json")
    assert json.loads(state.read_text())["steps"] == RANKS * 4 * 5
