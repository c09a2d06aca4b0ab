from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from renet.errors import RenetError
from renet.evaluation.rollout import Trace
from renet.evaluation.success import SuccessCfg, outcome, run_success, worse_than_blind
from renet.faults import View
from renet.terrain.tiles import tiles

from .fakes import FakeLab, FakeWorld


class Hurdles(FakeWorld):
    """Robots cross after 20 steps; on gaps beyond level 2 they fall, beyond level 4 they stand."""

    worlds = 0

    def place(self, levels: np.ndarray, kinds: np.ndarray) -> None:
        Hurdles.worlds += 1
        gap = kinds == list(tiles()).index("gap")
        self.falls = gap & (levels >= 2) & (levels < 4)
        self.stands = gap & (levels >= 4)
        self.clock = 0

    def step(self, action: np.ndarray):
        readings = super().step(action)
        self.clock += 1
        over = (self.clock % 20 == 0) & ~self.stands
        readings.ended[:] = over
        # A second try would succeed, and must not count.
        readings.fell[:] = over & self.falls & (self.clock <= 20)
        return readings


class HurdlesLab(FakeLab):
    def world(self, task, robots, speed, seed):
        yaw = task.events["spawn"].params["pose_range"]["yaw"]
        assert -0.2 < yaw[0] < yaw[1] < 0.2
        return Hurdles(len(robots))


def cfg(out: Path, **settings) -> SuccessCfg:
    return SuccessCfg(
        out=out, kinds=("gap", "stairs_up"), levels=(1, 3, 5), trials=3, seconds=2, **settings
    )


def test_only_the_first_try_counts() -> None:
    trace = Trace.empty(5, 4)
    trace.ended[1, 0] = trace.ended[2, 1] = trace.fell[2, 1] = trace.ended[4, 1] = True
    trace.ended[0, 3] = trace.ended[3, 3] = trace.fell[3, 3] = True
    crossed, fell, seconds = outcome(trace)
    assert crossed.tolist() == [True, False, False, True]
    assert fell.tolist() == [False, True, False, False]
    np.testing.assert_allclose(seconds, [0.04, 0.06, np.nan, 0.02])


def test_every_size_and_mode_has_its_row(tmp_path: Path) -> None:
    run_success(cfg(tmp_path), HurdlesLab())
    summary = json.loads((tmp_path / "summary.json").read_text())
    runs = {(r["kind"], r["level"], r["mode"]): r for r in summary["runs"]}
    assert len(runs) == 2 * 3 * 3
    for mode in ("vp", "renet", "op"):
        assert runs["gap", 1, mode]["crossed"] == 3
        assert runs["gap", 3, mode]["falls"] == 3
        assert runs["gap", 5, mode]["stuck"] == 3
        assert runs["stairs_up", 5, mode]["success_rate"] == 1
    row = runs["gap", 1, "renet"]
    assert row["size_m"] == pytest.approx(0.10)
    assert row["median_seconds"] == pytest.approx(0.4)
    assert row["success_ci95_low"] == row["success_ci95_high"] == 1
    assert runs["gap", 5, "op"]["median_seconds"] is None
    assert summary["worse"] == []
    assert summary["provenance"]["bundle_hash"] == "0" * 64
    assert (tmp_path / "success.png").stat().st_size > 10_000
    assert (tmp_path / "summary.csv").read_text().count("\n") == 19


def test_finished_kinds_are_not_run_again(tmp_path: Path) -> None:
    first = run_success(cfg(tmp_path), HurdlesLab())
    next((tmp_path / "parts").glob("stairs_up-*.json")).unlink()
    Hurdles.worlds = 0
    assert run_success(cfg(tmp_path), HurdlesLab())["runs"] == first["runs"]
    assert Hurdles.worlds == 1
    run_success(cfg(tmp_path, seed=2), HurdlesLab())
    run_success(cfg(tmp_path), HurdlesLab())
    assert Hurdles.worlds == 3


def test_where_renet_crosses_less_often_than_op_alone_is_listed() -> None:
    runs = [
        {"kind": "gap", "level": level, "size_m": level / 10, "mode": mode, "success_rate": rate}
        for level, mode, rate in [
            (1, "renet", 0.9),
            (1, "op", 0.91),
            (2, "renet", 0.5),
            (2, "op", 0.8),
            (3, "renet", 0.5),
        ]
    ]
    assert worse_than_blind(runs) == [{"kind": "gap", "size_m": 0.2, "renet": 0.5, "op": 0.8}]


@pytest.mark.parametrize(
    "wrong",
    [
        {"kinds": ("lava",)},
        {"levels": (0,)},
        {"levels": ()},
        {"modes": ("x",)},
        {"speed": 0.0},
        {"speed": -0.6, "fault": "foam"},
        {"trials": 0},
        {"fault": "gremlins"},
        {"fault": "frozen", "severity": 9},
    ],
)
def test_bad_settings_are_refused(wrong) -> None:
    with pytest.raises(RenetError):
        SuccessCfg(**wrong)


def test_faults_of_the_scene_reach_the_cameras(tmp_path: Path) -> None:
    seen = []

    class Hall(Hurdles):
        def disturb(self, view: View) -> None:
            seen.append(float(view.lift.max()))

    class HallLab(FakeLab):
        def world(self, task, robots, speed, seed):
            return Hall(len(robots))

    run_success(cfg(tmp_path, fault="foam", speed=1.5), HallLab())
    assert seen[0] == 0
    assert max(seen) == pytest.approx(0.07)


def test_a_fault_begins_before_the_obstacle() -> None:
    (injection,) = SuccessCfg(fault="frozen", severity=2, speed=0.6).schedule
    assert injection.onset == 75
