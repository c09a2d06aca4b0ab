from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from renet.errors import RenetError
from renet.evaluation.healthy import successful_runs
from renet.evaluation.rollout import Row, Trace, run_rollout
from renet.evaluation.terrain import TerrainCfg, highest_level, passed, run_terrain
from renet.terrain.tiles import LEVELS, tiles

from .fakes import FakeController, FakeLab, FakeSwitch, FakeWorld


class Ladder(FakeWorld):
    """Robots leave their tile after 20 steps up to a level of their kind, and fall above it."""

    worlds = 0
    reach = np.array(
        [10 if k == "stairs_up" else {"stairs_down": 3, "gap": 6}.get(k, 4) for k in tiles()]
    )
    able: np.ndarray | None = None
    """Who can; None on flat ground, which nobody leaves."""

    def place(self, levels: np.ndarray, kinds: np.ndarray) -> None:
        Ladder.worlds += 1
        self.able = levels < self.reach[kinds]
        self.clock = 0

    def step(self, action: np.ndarray):
        readings = super().step(action)
        if self.able is None:
            readings.fell[0] = readings.ended[0] = True
            return readings
        self.clock += 1
        over = np.full(self.num_robots, self.clock % 20 == 0)
        readings.ended[:] = over
        readings.fell[:] = over & ~self.able
        return readings


class LadderLab(FakeLab):
    def world(self, task, robots, speed, seed):
        return Ladder(len(robots))


def test_highest_level_counts_passes_in_a_row() -> None:
    levels_passed = np.array([[1, 1, 0], [1, 0, 0], [0, 1, 0], [1, 1, 1]], bool)
    np.testing.assert_array_equal(highest_level(levels_passed), [2, 1, 0])


def test_a_robot_passes_by_leaving_its_tile_even_after_a_fall() -> None:
    trace = Trace.empty(4, 3)
    trace.ended[[0, 2], 0] = trace.fell[0, 0] = True
    trace.ended[1, 1] = trace.fell[1, 1] = True
    assert passed(trace).tolist() == [True, False, False]


def test_summary_holds_the_papers_table(tmp_path: Path) -> None:
    run_terrain(TerrainCfg(out=tmp_path, robots=3, seconds=2), LadderLab())
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["levels_by_kind"] == {
        "gap": 6,
        "platform": 4,
        "stairs_up": 10,
        "stairs_down": 3,
    }
    assert summary["levels"] == {"gap": 6, "platform": 4, "stairs": 6.5}
    assert summary["robots"] == 3
    assert summary["falls_on_flat"] == 100
    assert summary["collisions"] == 0
    assert 0.99 < summary["lin_vel_reward"] <= 1
    assert len(summary["runs"]) == 4 * LEVELS
    assert (tmp_path / "terrain.png").stat().st_size > 10_000


def test_finished_kinds_are_not_climbed_again(tmp_path: Path) -> None:
    first = run_terrain(TerrainCfg(out=tmp_path, robots=3, seconds=2), LadderLab())
    next((tmp_path / "parts").glob("gap-*.json")).unlink()
    Ladder.worlds = 0
    again = run_terrain(TerrainCfg(out=tmp_path, robots=3, seconds=2), LadderLab())
    assert again["runs"] == first["runs"]
    assert Ladder.worlds == 1


@pytest.mark.parametrize(
    "wrong", [{"kinds": ("lava",)}, {"kinds": ()}, {"robots": 0}, {"mode": "x"}]
)
def test_bad_settings_are_refused(wrong) -> None:
    with pytest.raises(RenetError):
        TerrainCfg(**wrong)


def test_only_successful_episodes_calibrate() -> None:
    trace = Trace.empty(25, 2)
    # Robot 0 falls at step 7 and stands at the end; robot 1 leaves its tile at step 12, then falls.
    trace.ended[7, 0] = trace.fell[7, 0] = True
    trace.ended[[12, 24], 1] = True
    trace.fell[24, 1] = True
    assert successful_runs(trace) == [(0, slice(2, 5)), (1, slice(0, 3))]


def test_no_success_means_no_runs() -> None:
    rows = [Row("vp")]
    trace = run_rollout(FakeWorld(1), FakeController(1), FakeSwitch(1, 1), rows, 10, 0)
    trace.fell[-1] = trace.ended[-1] = True
    assert successful_runs(trace) == []
