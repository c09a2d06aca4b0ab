"""The recipe's phases."""

from pathlib import Path

import pytest

from renet import training
from renet.options import TASK
from renet.tasks.schedule import value_at
from renet.training import checkpoint as checkpoints
from renet.training.recipe import PHASES, over_phases
from renet.training.train import TrainCfg

SHIPPED = Path(training.__file__).parents[1] / "pretrained" / "checkpoint"


def test_value_is_reached_at_phase_end():
    values = 5.0, 4.0, 3.0, 2.0, 1.0
    schedule = over_phases(*values)
    ends = [1e6 * end for end in PHASES.values()]
    assert [value_at(schedule, end) for end in ends] == pytest.approx(values)
    assert value_at(schedule, 0.0) == 5.0
    assert value_at(schedule, (ends[0] + ends[1]) / 2) == pytest.approx(4.5)
    assert value_at(schedule, 1e9) == 1.0


def test_standing_and_narrow_gaps_begin_late():
    params = TrainCfg.from_task(TASK).env.curriculum["level"].params
    assert value_at(params["easier_share"], 30e6) == 0.0
    assert value_at(params["easier_share"], 150e6) == pytest.approx(0.25)


def test_what_an_earlier_recipe_had_is_left_out_on_resuming():
    cfg = TrainCfg.resumed(checkpoints.load_state(checkpoints.find(SHIPPED)))
    assert "easier_after" not in cfg.env.curriculum["level"].params
    assert cfg.agent.algorithm.entropy.endswith("0.001@226.3M")
