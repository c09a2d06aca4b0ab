from dataclasses import replace

import numpy as np
import pytest

from renet.evaluation.studies import terrain
from renet.evaluation.trace import Trace
from renet.terrain.tiles import LEVELS

from ..fakes import FakeEvaluator
from ..tiny import TINY, Hurdles, HurdlesEvaluator, Ladder


def test_a_robot_passes_even_after_a_fall_and_levels_count_in_a_row():
    trace = Trace.empty(4, 3)
    trace.ended[[0, 2], 0] = trace.fell[0, 0] = True
    trace.ended[1, 1] = trace.fell[1, 1] = True
    assert terrain.passed(trace).tolist() == [True, False, False]
    levels_passed = np.array([[1, 1, 0], [1, 0, 0], [0, 1, 0], [1, 1, 1]], bool)
    np.testing.assert_array_equal(terrain.highest_level(levels_passed), [2, 1, 0])


def test_summary_holds_the_papers_table(run_study):
    folder, summary = run_study("terrain")
    assert summary == summary | {
        "levels_by_kind": {"gap": 2, "platform": 4, "stairs_up": 10, "stairs_down": 3},
        "levels": {"gap": 2, "platform": 4, "stairs": 6.5},
        **{"robots": 3, "falls_on_flat": 100, "collisions": 0},
    }
    assert 0.99 < summary["lin_vel_reward"] <= 1
    assert len(summary["runs"]) == 4 * LEVELS
    assert (folder / "terrain.png").stat().st_size > 10_000


def test_stairs_up_and_down_of_one_robot_are_one_observation():
    """Of robots that are as good up as they are bad down, the mean is known exactly."""
    up = np.arange(10)
    study = terrain.TerrainStudy(levels=tuple(range(1, 10)), modes=("camera",), robots=10)
    parts = {"flat": {"falls": 0}}
    for kind, highest in {"stairs_up": up, "stairs_down": 9 - up}.items():
        rows = (np.arange(9)[:, None] < highest).tolist()
        parts[kind] = {"passed": rows, "steps": 1, "collisions": 0.0, "lin_vel_reward": 0.0}
    study = replace(study, kinds=("stairs_up", "stairs_down"))
    table = study._paper_table(parts)
    assert table["levels"] == {"stairs": 4.5}
    assert table["levels_ci95"]["stairs"] == (4.5, 4.5)


def test_the_table_of_levels_holds_levels_alone_and_falls_have_their_own(run_study):
    _, summary = run_study("terrain")
    tables = TINY["terrain"].tables(summary)
    (levels,) = (rows for _, header, rows in tables if header == ("tile", "level"))
    assert [kind for kind, _ in levels] == [*summary["levels_by_kind"]]
    assert [rows for _, header, rows in tables if header == ("robots", "falls")] == [[(3, 100)]]


def test_collisions_are_those_of_the_first_mode(tmp_path):
    class Scraping(Ladder):
        def result(self, speed, fell):
            result = super().result(speed, fell)
            result.collisions[:] = np.arange(self.num_robots) // 3 % 2  # OP's.
            return result

    study = replace(TINY["terrain"], out=tmp_path, modes=("camera", "blind"), kinds=("gap",))
    assert study.run(FakeEvaluator(Scraping))["collisions"] == 0


def test_only_the_first_try_counts():
    trace = Trace.empty(5, 4)
    trace.ended[1, 0] = trace.ended[2, 1] = trace.fell[2, 1] = trace.ended[4, 1] = True
    trace.ended[0, 3] = trace.ended[3, 3] = trace.fell[3, 3] = True
    crossed, fell, seconds = trace.first_try()
    assert np.vstack([crossed, fell]).tolist() == [[1, 0, 0, 1], [0, 1, 0, 0]]
    np.testing.assert_allclose(seconds, [0.04, 0.06, np.nan, 0.02])


def test_every_size_and_mode_has_its_row(run_study):
    folder, summary = run_study("success")
    runs = {(r["kind"], r["level"], r["mode"]): r for r in summary["runs"]}
    assert len(runs) == 2 * 3 * 3
    for mode in ("camera", "memory", "blind"):
        assert runs["gap", 1, mode]["passed"] == 3
        assert (runs["gap", 3, mode]["falls"], runs["gap", 3, mode]["passed"]) == (3, 0)
        assert runs["gap", 5, mode]["stuck"] == 3
        assert runs["stairs_up", 5, mode]["success_rate"] == 1
    row = runs["gap", 1, "memory"]
    assert (row["size_m"], row["median_seconds"]) == pytest.approx((0.1, 0.4))
    assert row["success_ci95_low"] == pytest.approx(0.025 ** (1 / 3), abs=1e-6)
    assert row["success_ci95_high"] == 1
    assert runs["gap", 5, "blind"]["median_seconds"] is None
    assert (summary["worse"], summary["provenance"]["bundle_hash"]) == ([], "0" * 64)
    assert (folder / "success.png").stat().st_size > 10_000
    assert (folder / "summary.csv").read_text().count("\n") == 19


def test_presets_in_one_folder_keep_their_own_results(tmp_path):
    """With the same settings the first try fails, which counts in `success` alone."""
    settings = {"levels": (3,), "modes": ("memory",), "robots": 3, "seconds": 2.0}
    passed = []
    for study in (terrain.TerrainStudy, terrain.SuccessStudy):
        in_one_folder = study(out=tmp_path, kinds=("gap",), **settings)
        (run,) = in_one_folder.run(FakeEvaluator(Hurdles))["runs"]
        passed.append(run["passed"])
    assert passed == [3, 0]


def test_a_highest_level_is_counted_from_the_first_level_on(tmp_path):
    """Robots pass the first two levels of gaps."""
    tiny = terrain.TerrainStudy(out=tmp_path, kinds=("gap",), robots=3, seconds=2.0)
    falling = replace(tiny, levels=(3, 2, 1))
    summary = falling.run(FakeEvaluator(Ladder))
    assert summary["levels"] == {"gap": 2.0}
    assert falling.tables(summary)[1][0] == "Mean highest level of 3 in mode memory"
    # Without the first level nobody knows.
    high = replace(tiny, levels=(2, 3))
    summary = high.run(FakeEvaluator(Ladder))
    assert summary["levels"] == summary["levels_by_kind"] == {}
    titles = [title for title, *_ in high.tables(summary)]
    assert titles == ["Robots that cross, % of 3", "On flat ground in mode memory"]


def test_dawns_sizes_are_walked_and_stated(tmp_path):
    """arXiv 2609.29092: stairs of 6 to 18 cm, gaps of 10 to 90 cm, steps of 10 to 54 cm."""
    walked = {}

    class Evaluator(HurdlesEvaluator):
        def make_env(self, task, robots, speed, seed):
            built = task.scene.terrain.terrain_generator.sub_terrains
            walked.update({k: [100 * built[k].measure(d) for d in (0, 1)] for k in study.kinds})
            return super().make_env(task, robots, speed, seed)

    study = terrain.DawnStudy(out=tmp_path, robots=3, modes=("camera",))
    rows = study.run(Evaluator())["runs"]
    stated = {kind: [100 * r["size_m"] for r in rows if r["kind"] == kind] for kind in study.kinds}
    for kind, sizes in (("stairs_up", [6, 18]), ("gap", [10, 90]), ("platform", [10, 54])):
        assert walked[kind] == stated[kind][::9] == pytest.approx(sizes)


def test_where_renet_crosses_less_often_than_op_alone_is_listed():
    rates = {1: (0.9, 0.91), 2: (0.5, 0.8), 3: (0.5,)}
    runs = [
        {"kind": "gap", "level": level, "size_m": level / 10, "mode": mode, "success_rate": rate}
        for level, both in rates.items()
        for mode, rate in zip(("memory", "blind"), both, strict=False)
    ]
    assert terrain.worse_than_blind(runs) == [
        {"kind": "gap", "size_m": 0.2, "memory": 0.5, "blind": 0.8}
    ]


def test_faults_of_the_scene_reach_the_cameras(tmp_path):
    seen = []

    class Hall(Hurdles):
        def perturb_cameras(self, view):
            seen.append(float(view.lift.max()))

    study = replace(TINY["success"], out=tmp_path, fault="foam:3", speed=1.5)
    study.run(FakeEvaluator(Hall))
    assert seen[0] == 0
    assert max(seen) == pytest.approx(0.07)


def test_a_fault_begins_before_the_obstacle():
    (injection,) = terrain.SuccessStudy(fault="frozen:2", speed=0.6).schedule
    (later,) = terrain.SuccessStudy(fault="frozen:2@4s+1s").schedule
    assert (injection.onset, later.onset, later.duration) == (75, 200, 1.0)


def test_own_ground_takes_the_place_of_tiles(tmp_path):
    walked = {}

    class Recording(FakeEvaluator):
        def make_env(self, task, robots, speed, seed):
            if not isinstance(task, str):
                walked.update(task.scene.terrain.terrain_generator.sub_terrains)
            return Ladder(len(robots))

    file = tmp_path / "map.npy"
    np.save(file, np.linspace(0.0, 0.4, 81 * 81).reshape(81, 81))
    study = replace(TINY["terrain"], out=tmp_path / "out", scene=file)
    runs = study.run(Recording())["runs"]
    assert [*walked] == ["own"]
    assert {run["kind"] for run in runs} == {"own"}
    assert [run["size_m"] for run in runs] == pytest.approx([0.04 * n for n in range(1, 11)])
    before = study.file_digests()
    np.save(file, np.zeros((81, 81)))
    assert study.file_digests() != before


def test_the_files_that_a_scene_includes_are_part_of_its_digest(tmp_path):
    scene = tmp_path / "scene.xml"
    scene.write_text("<mujoco><include file='ground.xml'/></mujoco>")
    ground = "<mujoco><worldbody><geom type='box' size='9 9 {}'/></worldbody></mujoco>"
    (tmp_path / "ground.xml").write_text(ground.format(0.1))
    study = replace(TINY["terrain"], out=tmp_path / "out", scene=scene)
    digests = []
    for height in (0.1, 0.1, 0.2):
        (tmp_path / "ground.xml").write_text(ground.format(height))
        digests.append(study.file_digests()["scene"])
    assert digests[0] == digests[1] != digests[2]


@pytest.mark.parametrize(
    ("asked", "walked"), [((1, 2, 3, 4, 6), [1, 2, 4]), ((10, 2), [2]), ((8, 10), [8, 10])]
)
def test_quick_walks_on_no_level_that_was_not_asked_for(asked, walked):
    study = terrain.SuccessStudy(levels=asked, robots=2, modes=("memory",), quick=True)
    assert [level for level, _ in study.settings] == walked
    assert study.robots_each == 2, "quick takes no more robots than are asked for"


def test_a_scene_has_one_level(tmp_path):
    file = tmp_path / "scene.xml"
    file.write_text("<mujoco><worldbody><geom type='plane' size='9 9 1'/></worldbody></mujoco>")
    study = replace(TINY["terrain"], out=tmp_path / "out", scene=file)
    summary = study.run(FakeEvaluator(Ladder))
    assert [(run["kind"], run["level"]) for run in summary["runs"]] == [("own", LEVELS)]
    assert [title for title, *_ in study.tables(summary)] == ["Robots that cross, % of 3"]
