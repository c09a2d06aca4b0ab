from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from renet.errors import RenetError
from renet.evaluation.studies.standing import StandingStudy, stillness

from ..fakes import FakeEnv, FakeEvaluator

QUICK = {"robots": 2, "walk": 0.2, "settle": 0.2, "stand": 0.4}


class Obedient(FakeEnv):
    """Stops on command; robots of uneven number sway their only joint for ever."""

    told = 0

    def place(self, levels: np.ndarray, kinds: np.ndarray) -> None:
        self.levels = levels
        self.clock, self.speed = 0, 0.6

    def command(self, speed: float) -> None:
        Obedient.told += 1
        self.speed = speed

    def step(self, action: np.ndarray):
        self.clock += 1
        before = self.x.copy()
        result = super().step(action)
        self.x = before + self.speed * 0.02
        return result

    def poses(self, rows) -> np.ndarray:
        pose = np.zeros((len(rows), 8))
        pose[:, 0] = self.x[list(rows)]
        pose[1::2, 7] = 0.1 * (self.clock % 2)
        return pose


class ObedientEvaluator(FakeEvaluator):
    def make_env(self, task, robots, speed, seed):
        return Obedient(len(robots))


def test_drift_counts_from_when_robots_should_stand_and_joints_all_along() -> None:
    poses = np.zeros((4, 1, 9))
    poses[:, 0, 0] = (0.0, 3.0, 3.0, 3.3)
    poses[:, 0, 1] = (0.0, 0.0, 0.0, 0.4)
    poses[:, 0, 7] = (0.0, 0.02, 0.02, 0.0)
    drift, speed = stillness(poses, settled=1)
    np.testing.assert_allclose(drift[:, 0], (0.0, 0.0, 0.5))
    np.testing.assert_allclose(speed[:, 0], (0.0, 0.5, 0.0, 0.5), atol=1e-12)


def test_robots_that_stop_stand_and_restless_ones_do_not(tmp_path: Path) -> None:
    Obedient.told = 0
    cfg = StandingStudy(out=tmp_path, kinds=("flat", "stairs_up"), **QUICK)
    cfg.run(ObedientEvaluator())
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert [(run["kind"], run["level"], run["mode"]) for run in summary["runs"]] == [
        ("flat", 1, "vp"), ("flat", 1, "op"), ("stairs_up", 3, "vp"), ("stairs_up", 3, "op")
    ]  # fmt: skip
    assert {(run["robots"], run["still"], run["falls"]) for run in summary["runs"]} == {(2, 1, 0)}
    assert all(run["drift_m"] == 0 for run in summary["runs"])
    assert (tmp_path / "standing.png").stat().st_size > 10_000
    cfg.run(ObedientEvaluator())
    assert Obedient.told == 1, "a finished study is not run again"


def test_the_simulated_world_obeys() -> None:
    from renet.evaluation.env import SimEnv, study_env_cfg

    world = SimEnv(study_env_cfg("Renet-Go1-Flat", 0.6), range(2), 1, "native")
    world.reset()
    world.command(0.0)
    after = world.step(np.zeros((2, 12), np.float32))
    np.testing.assert_allclose(after.proprioception[:, 6], 0.0)


@pytest.mark.parametrize(
    "wrong", [{"kinds": ("lava",)}, {"modes": ("x",)}, {"level": 11}, {"robots": 0}, {"stand": 0}]
)
def test_bad_settings_are_refused(wrong) -> None:
    with pytest.raises(RenetError):
        StandingStudy(**wrong)
