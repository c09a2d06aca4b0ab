"""The exported blind policy and the pilot's actions in the mode `blind`."""

from pathlib import Path

import numpy as np
import pytest
import torch
from tests.pilot import test_pilot

import renet
from referee import Cfg, main

CHECKPOINT = Path(__file__).parents[1] / "go2"
OBSERVATIONS = test_pilot.WALKS["switch_observation"][:, None]
"""Observations of a recorded walk, [T, 1, 45]."""


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> torch.jit.ScriptModule:
    return torch.jit.load(main(Cfg(CHECKPOINT, tmp_path_factory.mktemp("referee") / "blind.pt")))


def walk(policy: torch.jit.ScriptModule, observations: np.ndarray) -> np.ndarray:
    """Actions of a walk, [T, 12]."""
    policy.reset()
    return torch.cat([policy(torch.from_numpy(rows)) for rows in observations]).numpy()


def test_it_acts_as_the_pilot_does(exported: torch.jit.ScriptModule) -> None:
    pilot = renet.load("go2-parkour", mode="blind")
    expected = []
    for step, rows in enumerate(OBSERVATIONS):
        expected.append(pilot.step(rows, None, 0.02 * step).action[0])
    assert np.ptp(expected, axis=0).min() > 0.5
    np.testing.assert_allclose(walk(exported, OBSERVATIONS), expected, atol=1e-5)


def test_a_new_walk_begins_without_memory(exported: torch.jit.ScriptModule) -> None:
    first = walk(exported, OBSERVATIONS[:12])
    # A walk that ends between two ticks, from another observation.
    walk(exported, OBSERVATIONS[40:52])
    np.testing.assert_array_equal(walk(exported, OBSERVATIONS[:12]), first)
