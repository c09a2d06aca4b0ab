"""The log's curves are rsl_rl's, and it waits for the device once in an iteration."""

import math

import pytest
import torch
from rsl_rl.utils.logger import Logger

from renet.training.episode_log import EpisodeLog

from ..waits import Waits

ROBOTS, STEPS = 6, 40


class Scalars(dict):
    """A writer that keeps the newest value of each curve."""

    def add_scalar(self, tag: str, value: float, step: int) -> None:
        self[tag] = float(value)


def make(kind: type[Logger]) -> Logger:
    cfg = {"algorithm": {"rnd_cfg": None}, "num_steps_per_env": STEPS}
    log = kind(
        log_dir=None,
        cfg=cfg,
        env_cfg=None,
        num_envs=ROBOTS,
        is_distributed=False,
        gpu_world_size=1,
        gpu_global_rank=0,
        device="cpu",
    )
    log.writer = Scalars()
    return log


def walk(log: Logger, seed: int) -> None:
    """An iteration's steps, in some of which episodes end and something is logged."""
    random = torch.Generator().manual_seed(seed)
    for step in range(STEPS):
        rewards = torch.rand(ROBOTS, generator=random)
        dones = (torch.rand(ROBOTS, generator=random) < 0.1).long()
        logged = {}
        if step % 3 == 0:
            logged = {"Episode_Reward/yaw": torch.rand((), generator=random), "plain": 0.5 * step}
        if step % 6 == 0:
            logged["Curriculum/level/gap"] = torch.tensor(step)
        log.process_env_step(rewards, dones, {"log": logged}, None)


def finish(log: Logger, iteration: int) -> None:
    log.log(iteration, 0, 9, 1.0, 1.0, {"surrogate": 0.1}, 1e-3, torch.ones(12), None)


def test_curves_are_rsl_rls():
    ours, theirs = make(EpisodeLog), make(Logger)
    for iteration in range(3):  # Episodes go on from one iteration to the next.
        for log in (ours, theirs):
            walk(log, iteration)
            finish(log, iteration)
        assert ours.writer.keys() == theirs.writer.keys()
        for name, value in theirs.writer.items():
            assert ours.writer[name] == pytest.approx(value, rel=1e-5), name
        assert {"Train/mean_reward", "Curriculum/level/gap", "Episode/plain"} <= set(ours.writer)
    assert list(ours.lenbuffer) == list(theirs.lenbuffer)
    torch.testing.assert_close(torch.tensor(ours.rewbuffer), torch.tensor(theirs.rewbuffer))


def test_steps_do_not_wait_for_the_device():
    log = make(EpisodeLog)
    with Waits() as watch:
        walk(log, 0)
    assert watch.waits == []


def test_an_iteration_without_any_end_has_no_mean_return():
    log = make(EpisodeLog)
    log.process_env_step(torch.ones(ROBOTS), torch.zeros(ROBOTS, dtype=torch.long), {"log": {}})
    finish(log, 0)
    assert "Train/mean_reward" not in log.writer
    assert math.isclose(log.writer["Loss/surrogate"], 0.1)


def test_workers_without_a_writer_keep_nothing():
    log = make(EpisodeLog)
    log.writer = None
    walk(log, 0)
    finish(log, 0)
    assert not log._ended
    assert not log.ep_extras
