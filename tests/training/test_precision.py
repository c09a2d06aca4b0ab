"""Learning in bfloat16 and side by side, and on a GPU's path without waiting for the device."""

import subprocess
import sys
import threading
import time

import pytest
import torch

from renet.models.config import ModelCfg
from renet.training import precision
from renet.training.config import NP3OCfg
from renet.training.precision import (
    compute_in,
    halve_threads,
    keep_freed_memory,
    learning_type,
    multiply_by_onednn,
    side_by_side,
)
from renet.training.storage import TickRollout

from ..waits import Waits
from .conftest import ToyEnv, collect, make_runner


def test_bfloat16_learns_what_single_precision_learns(two_threads):
    losses, models = [], []
    for kind in ("float32", "bfloat16"):
        env = ToyEnv(num_envs=16)
        small = ModelCfg(critic_hidden=(64, 64))
        alg = make_runner(env, model=small, precision=kind, algorithm=NP3OCfg()).alg
        before = alg.model.state_dict()["critics.reward.0.weight"].clone()
        collect(alg, env)
        losses.append(alg.update())
        after = alg.model.state_dict()
        assert all(tensor.dtype != torch.bfloat16 for tensor in after.values())
        models.append((after["critics.reward.0.weight"] - before).flatten())
    for name, value in losses[0].items():
        assert losses[1][name] == pytest.approx(value, rel=0.03, abs=2e-3), name
    assert torch.cosine_similarity(*models, dim=0) > 0.95


def test_compute_in_is_temporary():
    layer, value = torch.nn.Linear(64, 8), torch.randn(3, 64)
    exact = layer(value)
    with compute_in(torch.bfloat16, layer):
        rounded = layer(value)
    assert rounded.dtype == torch.float32
    assert 0 < (rounded - exact).abs().max() < 0.05
    assert torch.equal(layer(value), exact)


@pytest.mark.parametrize("has", [True, False])
def test_automatic_precision_follows_the_hardware(monkeypatch, has):
    monkeypatch.setattr(precision, "has_bfloat16", lambda device: has)
    assert learning_type("auto", "cpu") == (torch.bfloat16 if has else torch.float32)
    assert learning_type("float32", "cpu") == torch.float32
    assert learning_type("bfloat16", "cpu") == torch.bfloat16


@pytest.fixture
def products():
    """Settings of matrix products, put back afterwards."""
    settings = torch.backends.mkldnn.matmul
    before = settings.fp32_precision
    yield settings
    settings.fp32_precision = before


@pytest.mark.parametrize("avx512", [True, False])
@pytest.mark.parametrize("amx", [True, False])
def test_onednn_multiplies_only_where_it_cannot_round(monkeypatch, products, avx512, amx):
    monkeypatch.setattr(torch.cpu, "_is_avx512_supported", lambda: avx512)
    monkeypatch.setattr(torch.cpu, "_is_amx_tile_supported", lambda: amx)
    before = products.fp32_precision
    assert multiply_by_onednn() == (avx512 and not amx)
    assert products.fp32_precision == ("bf16" if avx512 and not amx else before)


def test_products_are_single_precision_on_this_machine(products):
    multiply_by_onednn()
    factors = torch.randn(2, 256, 256, generator=torch.Generator().manual_seed(0))
    exact = factors[0].double() @ factors[1].double()
    torch.testing.assert_close(factors[0] @ factors[1], exact.float(), atol=1e-4, rtol=0)


def fail() -> int:
    raise ValueError("no")


def test_side_by_side_shares_threads(two_threads):
    meeting = threading.Barrier(2, timeout=20)

    def work() -> int:
        meeting.wait()  # Passes only if both run at once.
        return torch.get_num_threads()

    with halve_threads("cpu"):
        assert torch.get_num_threads() == 1
        assert side_by_side(work, work) == (1, 1)
        for pair in ((fail, lambda: 1), (lambda: 1, fail)):
            with pytest.raises(ValueError, match="no"):
                side_by_side(*pair)
        assert side_by_side(work, work) == (1, 1)
    assert torch.get_num_threads() == 2
    with pytest.raises(ValueError, match="no"), halve_threads("cpu"):
        fail()
    assert torch.get_num_threads() == 2


def runs_at_once() -> bool:
    """Whether two pieces of work get a thread each."""
    return len(set(side_by_side(threading.get_ident, threading.get_ident))) == 2


@pytest.mark.parametrize("longer", [0, 1])
def test_idle_half_serves_nested_work(two_threads, longer):
    may_end = threading.Event()

    def divided() -> list[bool]:
        found = [runs_at_once()]
        may_end.set()
        for _ in range(10_000):
            found.append(runs_at_once())
            if found[-1]:
                break
            time.sleep(1e-3)
        return [found[0], found[-1]]

    pieces = [may_end.wait, may_end.wait]
    pieces[longer] = divided
    with halve_threads("cpu"):
        assert side_by_side(*pieces)[longer] == [False, True]
        assert runs_at_once()


@pytest.mark.parametrize("device", ["cpu", "cuda"])
def test_one_thread_or_gpu_divides_nothing(two_threads, device):
    threads = 1 if device == "cpu" else 2
    torch.set_num_threads(threads)
    with halve_threads(device):
        done = side_by_side(threading.get_ident, threading.get_ident)
        assert torch.get_num_threads() == threads
    assert done == (threading.get_ident(),) * 2


@pytest.mark.parametrize("kind", ["float32", "bfloat16"])
def test_learning_at_once_is_learning_in_turn(two_threads, kind):
    """The same seed gives the same curve, each time and on one thread."""
    states = []
    for threads in (2, 2, 1):
        torch.set_num_threads(threads)
        env = ToyEnv(num_envs=16)
        small = ModelCfg(critic_hidden=(64, 64), detector="variance")
        runner = make_runner(env, model=small, precision=kind, algorithm=NP3OCfg())
        for _ in range(2):
            collect(runner.alg, env)
            losses = runner.alg.update()
        states.append((losses, runner.alg.model.state_dict(), torch.get_rng_state()))
    for other in states[1:]:
        torch.testing.assert_close(other, states[0], atol=0, rtol=0)


def test_policy_update_never_waits():
    env = ToyEnv()
    alg = make_runner(env, precision="float32").alg
    with Waits() as watch:
        collect(alg, env)
        orders = alg.np3o.draw_orders(alg._rollout)
        alg.np3o.update(alg._rollout, alg._last_value, orders, 0)
    assert watch.waits == ["lift_fresh"], "the budgets alone, once an iteration"
    # It saw the way back and the optimiser, too.
    assert {"elu_backward", "_fused_adam_"} <= watch.seen


@pytest.mark.parametrize("iteration", [0, 20])
def test_supervision_waits_once(iteration):
    env = ToyEnv()
    alg = make_runner(env, precision="float32").alg
    alg.iteration = iteration  # From 20 on OP learns, too.
    collect(alg, env)
    with Waits() as watch:
        alg.supervision.update(TickRollout(**alg._ticks.stack()))
    first, *at_the_end = watch.waits
    assert first == "tolist"
    assert at_the_end == ["_linalg_svd"] * (1 if iteration == 0 else 2)
    assert {"convolution_backward", "_fused_adam_", "nonzero_static"} <= watch.seen


TAKE_AND_FREE = """
import resource, runpy, sys, torch

def faults():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(40):
        torch.ones(16 << 20)
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

by_default = faults()
kept = runpy.run_path(sys.argv[1])["keep_freed_memory"]()
print(by_default, faults() if kept else "none")
"""
"""Prints the page faults of 64 MiB (16,384 pages of 4 KiB) forty times, before and after."""


def test_memory_taken_again_brings_few_page_faults():
    # The settings stay with a process; without renet's package this one needs PyTorch alone.
    command = [sys.executable, "-c", TAKE_AND_FREE, precision.__file__]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    by_default, kept = done.stdout.split()
    if kept == "none":
        pytest.skip("the C library is not glibc")
    # Something small may lie in the way the first few times, so that the heap grows again.
    assert 3 * int(kept) < int(by_default)


def test_without_glibc_nothing_is_changed(monkeypatch):
    monkeypatch.setattr(precision.ctypes, "CDLL", lambda name: object())
    assert not keep_freed_memory()
