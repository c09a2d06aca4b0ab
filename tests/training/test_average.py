"""The mean of a run's last weights."""

import pytest
import torch
from torch import nn

from renet.training.average import WeightAverage


def constant(value: float) -> nn.Module:
    module = nn.BatchNorm1d(3)
    for parameter in module.parameters():
        nn.init.constant_(parameter, value)
    module.num_batches_tracked.fill_(int(value))
    return module


@pytest.mark.parametrize(("over", "low", "high"), [(10, 88, 93), (1, 99.9, 100.1)])
def test_average_is_a_moving_mean(over, low, high):
    average, expected = WeightAverage(constant(0), over), 0.0
    for update in range(1, 101):
        average.update_parameters(constant(update))
        expected += (update - expected) / max(1, min(over, update / 4))
        if update == 50:  # Goes on where it was saved.
            saved, average = average, WeightAverage(constant(5), over)
            average.load(saved.module.state_dict(), int(saved.n_averaged))
    found = average.module.state_dict()
    torch.testing.assert_close(found["weight"], torch.full((3,), expected))
    assert low < expected < high
    assert found["num_batches_tracked"] == 100
