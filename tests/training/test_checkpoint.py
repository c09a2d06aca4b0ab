"""The mean of a run's last weights."""

import torch
from torch import nn

from renet.training.checkpoint import WeightAverage


def constant(value: float) -> nn.Module:
    module = nn.BatchNorm1d(3)
    for parameter in module.parameters():
        nn.init.constant_(parameter, value)
    module.num_batches_tracked.fill_(int(value))
    return module


def test_is_the_moving_mean_of_what_it_saw_and_counts_are_the_newests():
    average = WeightAverage(constant(0), over=10)
    expected = 0.0
    for update in range(1, 101):
        average.update(constant(update))
        share = 1 / max(1, min(10, update / 4))
        expected += share * (update - expected)
    torch.testing.assert_close(average.tensors["weight"], torch.full((3,), expected))
    assert 88 < expected < 93
    assert average.tensors["num_batches_tracked"] == 100


def test_over_one_is_the_newest():
    average = WeightAverage(constant(0), over=1)
    for update in range(9):
        average.update(constant(update))
        torch.testing.assert_close(average.tensors["weight"], torch.full((3,), float(update)))


def test_goes_on_where_it_was_saved():
    whole, first = (WeightAverage(constant(0), over=8) for _ in range(2))
    for update in range(20):
        whole.update(constant(update))
        first.update(constant(update))
    second = WeightAverage(constant(5), over=8)
    second.load(first.tensors, first.updates)
    whole.update(constant(1))
    second.update(constant(1))
    torch.testing.assert_close(whole.tensors["bias"], second.tensors["bias"])
