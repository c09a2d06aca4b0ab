"""Which robots lose their images in training, how often and for how long."""

from itertools import pairwise

import numpy as np
import pytest
import torch
from scipy import stats

from renet.errors import RenetError
from renet.training.config import WithholdingCfg
from renet.training.withholding import Withholding
from tests.training.conftest import ToyEnv, collect, make_runner


def watch(cfg: WithholdingCfg, robots: int, ticks: int, *easier_and_steps) -> np.ndarray:
    """[ticks, N] bool: images that arrived."""
    torch.manual_seed(3)
    withholding, fresh = Withholding(cfg, robots, "cpu"), torch.ones(robots, dtype=torch.bool)
    seen = []
    for _ in range(ticks):
        seen.append(withholding.tick(fresh, *easier_and_steps))
        fresh = torch.zeros_like(fresh)
    return torch.stack(seen).numpy()


def test_half_of_robots_lose_images():
    seen = watch(WithholdingCfg(share=0.5), 64, 600)
    assert seen[0].all()
    loses = ~seen.all(axis=0)
    assert loses.tolist() == [False, True] * 32
    assert Withholding(WithholdingCfg(share=0.25), 12, "cpu")._robots.sum() == 3


def test_times_without_images_are_log_uniform():
    cfg = WithholdingCfg(share=1.0, shortest=0.5, longest=5.0, sight=2.0)
    seen = watch(cfg, 200, 3000)
    lengths: dict[bool, list[int]] = {False: [], True: []}
    for column in seen.T:
        edges = np.flatnonzero(np.diff(column)) + 1
        for begin, end in pairwise(edges):
            lengths[bool(column[begin])].append(end - begin)
    lost = np.log(np.array(lengths[False]) / 10)
    assert lost.min() >= np.log(0.5)
    assert lost.max() <= np.log(5.0) + 0.05
    # In whole ticks: the longest distance between the distributions is less than a tick's share.
    drawn = stats.uniform(np.log(0.5), np.log(10.0))
    assert stats.ks_1samp(lost, drawn.cdf).statistic < 0.1
    # Memoryless, by the tick: at least one between two losses.
    assert np.mean(lengths[True]) / 10 == pytest.approx(2.0, rel=0.05)


def test_easier_tiles_follow_schedules():
    cfg = WithholdingCfg(1.0, easier_shortest="0.3@1M,4@1M", easier_sight="9@1M,0.2@1M")
    easier = torch.tensor([0.0, 1.0]).repeat(50)
    before, after = (watch(cfg, 100, 40, easier, steps) for steps in (0, 2_000_000))
    assert (before[:, ::2] == after[:, ::2]).all(), "other tiles stay as they were"
    assert before[:, 1::2].mean() > before[:, ::2].mean() > 0.4
    assert after[:, 1::2].mean() < 0.15


def test_nothing_is_withheld_by_default():
    assert watch(WithholdingCfg(), 8, 200).all()


def test_an_episode_that_begins_sees_again():
    withholding = Withholding(WithholdingCfg(share=1.0, sight=0.1), 4, "cpu")
    no = torch.zeros(4, dtype=torch.bool)
    assert not withholding.tick(no).any()
    assert withholding.tick(torch.tensor([True, False, True, False])).tolist() == [1, 0, 1, 0]


@pytest.mark.parametrize(
    "wrong", [{"share": 1.5}, {"shortest": 0}, {"shortest": 9}, {"sight": 0}, {"easier_sight": 0}]
)
def test_wrong_settings_are_refused_by_name(wrong):
    with pytest.raises(RenetError, match=f"withholding.{next(iter(wrong))}"):
        WithholdingCfg(**wrong)


def test_critics_observe_image_age():
    torch.manual_seed(0)
    env = ToyEnv()
    alg = make_runner(env, withholding=WithholdingCfg(share=0.5, sight=0.3)).alg
    collect(alg, env, steps=100)
    has_image = torch.stack([row["has_image"] for row in alg._ticks._rows])
    assert has_image[:, ::2].all()
    assert 0.1 < has_image[:, 1::2].float().mean() < 0.9
    age = alg._rollout.critic_observation[..., -2].unflatten(0, (-1, 5))[:, 0]
    lost = (~has_image).float()
    # Normalised, so that what was never lost is below what was.
    assert age[lost > 0].min() > age[lost == 0].max()
    assert len(alg.update()) > 5
