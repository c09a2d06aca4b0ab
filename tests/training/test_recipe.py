"""The recipe's phases."""

import re
from pathlib import Path

import pytest

from renet import training
from renet.options import TASK
from renet.tasks.schedule import Schedule, value_at
from renet.training import checkpoint as checkpoints
from renet.training.config import steps_per_env
from renet.training.recipe import PHASES, over_phases
from renet.training.train import TrainCfg

ROOT = Path(__file__).parents[2]
SHIPPED = Path(training.__file__).parents[1] / "pretrained" / "checkpoint"


def test_value_is_reached_at_phase_end():
    values = 5.0, 4.0, 3.0, 2.0, 1.0
    schedule = over_phases(*values)
    ends = [1e6 * end for end in PHASES.values()]
    assert [value_at(schedule, end) for end in ends] == pytest.approx(values)
    assert value_at(schedule, 0.0) == 5.0
    assert value_at(schedule, (ends[0] + ends[1]) / 2) == pytest.approx(4.5)
    assert value_at(schedule, 1e9) == 1.0


def scheduled(cfg: TrainCfg) -> dict[str, Schedule]:
    """What changes during a run, by its row of the table in benchmarks/NOTES.md."""
    algorithm, withholding = cfg.agent.algorithm, cfg.agent.withholding
    params = {name: term.params for name, term in cfg.env.curriculum.items()}
    return {
        "steps in an iteration": cfg.agent.batch_size,
        "weight of the entropy bonus": algorithm.entropy,
        "largest standard deviation of actions": algorithm.max_std,
        "new velocities that robots are given at once": params["kick_share"]["schedule"],
        "desired KL divergence": algorithm.desired_kl,
        "learning rate of estimators and detector": cfg.agent.supervision.learning_rate,
        "reward of a contact of trunk, thigh or calf": params["collision_weight"]["schedule"],
        "reward of a foot that is not lifted": params["foot_clearance_weight"]["schedule"],
        "budget of joint speeds": algorithm.cost_budget[1],
        "standing, for so much of other goals' time": params["command_stage"]["standing_time"],
        "proportion of robots on rough ground": params["tile_shares"]["shares"]["rough"],
        "proportions of those at gaps and at platforms": params["tile_shares"]["shares"]["gap"],
        "share of gaps easier than the robot's level": params["level"]["easier_share"],
        "of the lowest levels": params["level"]["easier_levels"],
        "images lost there for at least, s": withholding.easier_shortest,
        "after a sight of, s, on average": withholding.easier_sight,
    }


def test_the_documented_phases_are_the_recipes():
    section = (
        (ROOT / "benchmarks" / "NOTES.md").read_text().partition("### The recipe's phases\n")[2]
    )
    lines = [line for line in section.partition("\n## ")[0].splitlines() if line.startswith("|")]
    titles, _, ends, *rows = [
        [cell.strip() for cell in line.strip("|").split("|")] for line in lines
    ]
    assert titles[1:] == list(PHASES)
    assert [int(end) for end in ends[1:]] == list(PHASES.values())
    schedules = scheduled(TrainCfg.from_task(TASK))
    assert [row[0] for row in rows] == list(schedules)
    for name, *cells in rows:
        for cell, end in zip(cells, PHASES.values(), strict=True):
            # Robots are not told to stand before the second phase ends.
            if cell != "no":
                value = float(cell.replace(",", "").replace("−", "-"))
                assert value_at(schedules[name], 1e6 * end) == pytest.approx(value), name


def test_the_documented_length_makes_300_million_steps():
    page = (ROOT / "docs" / "train.md").read_text()
    said = re.search(r"--max-iterations (\d+)` makes 300 M with (\d+) to (\d+) robots", page)
    iterations, fewest, most = map(int, said.groups())
    cfg = TrainCfg.from_task(TASK)
    for robots in (fewest, most):
        steps = 0
        for _ in range(iterations):
            steps += robots * steps_per_env(None, cfg.agent.batch_size, robots, steps)
        assert 300e6 <= steps < 315e6


def test_standing_and_narrow_gaps_begin_late():
    params = TrainCfg.from_task(TASK).env.curriculum["level"].params
    assert value_at(params["easier_share"], 30e6) == 0.0
    assert value_at(params["easier_share"], 150e6) == pytest.approx(0.25)


def test_what_an_earlier_recipe_had_is_left_out_on_resuming():
    cfg = TrainCfg.resumed(checkpoints.load_state(checkpoints.find(SHIPPED)))
    assert "easier_after" not in cfg.env.curriculum["level"].params
    assert cfg.agent.algorithm.entropy.endswith("0.001@226.3M")
