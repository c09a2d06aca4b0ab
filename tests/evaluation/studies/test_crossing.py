"""Version 2 of the fault benchmark, on robots whose crossings are known."""

import json

import numpy as np
import pytest

from renet.errors import RenetError
from renet.evaluation.studies.benchmark import read_result
from renet.evaluation.studies.crossing import CrossingStudy, Setting, drawn_faults, score
from renet.evaluation.studies.leaderboard import LeaderboardCfg, make_leaderboard
from renet.evaluation.studies.one_try import OneTryStudy
from renet.faults import FAULTS
from renet.faults.physical import PhysicalFault

from ..fakes import FakeEnv, FakeEvaluator
from .test_leaderboard import complete
from .test_memory import Trusting


class Leaving(FakeEnv):
    """Robots leave their tile 3 m from its middle; every fourth falls at 2.5 m, fault or not."""

    def step(self, action):
        result = super().step(action)
        weak = (np.arange(self.num_robots) % 10 % 4 == 0) & (self.x > 2.5)
        result.fell[:] |= weak
        result.ended[:] = result.fell | (self.x > 3.0)
        self.x[result.ended] = 0.0
        return result


class Evaluator(FakeEvaluator):
    def make_policy(self, num_robots):
        return Trusting(num_robots)  # VP falls where its images are black.


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("benchmark")
    study = CrossingStudy(
        out=out, quick=True, grounds=("gap",), modes=("camera", "switch", "blind"), seconds=6.0
    )
    study.run(Evaluator(Leaving))
    return out


@pytest.fixture
def summary(folder):
    return json.loads((folder / "summary.json").read_text())


def test_kept_is_what_twins_cross_and_crossed_is_all(summary):
    scores = summary["scores"]
    black = [r for r in summary["runs"] if (r["mode"], r["fault"]) == ("camera", "blackout")]
    counts = [[r[n] for n in ("crossed", "kept", "twins", "upright")] for r in black]
    assert counts == [[0, 0, 7, 0]] * 2
    for mode in ("switch", "blind"):  # The paper's switch leaves black images in 35 ms.
        assert (scores[mode]["crossed"], scores[mode]["kept"]) == (0.7, 1.0)
    assert scores["camera"]["kept"] < 1.0
    assert scores["camera"]["healthy"] == scores["blind"]["healthy"] == 0.7
    assert len(scores["camera"]["by_robot"]) == 10


def test_cameras_fail_a_distance_before_the_edge():
    class Walk:
        travelled = np.array([[0.0, 0.0], [0.5, 0.2], [0.9, 0.5], [1.2, 0.6]])

    study = CrossingStudy()
    assert study._onsets(Walk, 1.2, Setting("blackout", 0.3, 1.0)) == [2, 75]  # type: ignore[arg-type]
    # The second never comes so far: when it should have been there, 0.9 m at 0.6 m/s.


def test_drawn_faults_are_the_seeds_and_no_scene_has_to_carry_them_out():
    assert drawn_faults(7) == drawn_faults(7)
    draws = [drawn_faults(seed) for seed in range(50)]
    assert len({json.dumps(draw) for draw in draws}) == 50
    faults = [fault for draw in draws for chain in draw.values() for fault in chain]
    assert not any(issubclass(FAULTS[name], PhysicalFault) for name, _ in faults)
    assert {severity for _, severity in faults} == {3, 4, 5}
    assert {len(chain) for draw in draws for chain in draw.values()} == {1, 2}


def test_a_seed_draws_what_it_drew_for_published_results():
    assert drawn_faults(0) == {
        "drawn_1": (("motion_blur", 3), ("unplugged", 3)),
        "drawn_2": (("gaussian", 3),),
        "drawn_3": (("edge_shadow", 4), ("intermittent_blackout", 5)),
        "drawn_4": (("unplugged", 5), ("wrong_scale", 3)),
    }


def test_kept_of_a_policy_that_crosses_nothing_is_not_a_number():
    values = {"crossed": np.zeros(3), "upright": np.ones(3), "twins": np.zeros(3)}
    assert score([{"values": values}])["kept"] is None


def test_the_interval_of_kept_is_over_robots():
    values = {"upright": np.ones(4), "twins": np.array([1, 1, 1, 0])}
    runs = [{"values": values | {"crossed": np.array(c)}} for c in ([1, 0, 1, 1], [1, 0, 0, 1])]
    scores = score(runs)
    assert scores["crossed"] == 5 / 8
    assert scores["kept"] == pytest.approx(3 / 6)
    assert 0.0 <= scores["kept_ci95_low"] < 0.5 < scores["kept_ci95_high"] <= 1.0


def test_the_result_is_valid_and_ranked(folder, tmp_path, capsys):
    result = read_result(folder / "result.json")
    assert result["version"] == 2
    assert (folder / "crossing.png").stat().st_size > 10_000
    assert result["faults"]["drawn_1"] == [list(f) for f in drawn_faults(0)["drawn_1"]]
    make_leaderboard(LeaderboardCfg((folder / "result.json",), tmp_path / "board.md"))
    rows = (tmp_path / "board.md").read_text().splitlines()[4:]
    assert [row.split(" | ")[1:3] for row in rows][-1] == ["fake", "camera"]
    # The paper's switch is no `renet`: differences are from the first mode, VP.
    by_robot = {mode: np.array(scores["by_robot"]) for mode, scores in result["scores"].items()}
    behind = 100 * (by_robot["camera"] - by_robot["switch"]).mean()
    cells = {row.split(" | ")[2]: row.rstrip(" |").split(" | ")[-1] for row in rows}
    assert cells["switch"].startswith(f"{behind:+.1f} (")
    assert cells["camera"] == "+0.0 (+0.0 to +0.0)"
    easier = result | {"settings": [row for row in result["settings"] if row["size"] == "easy"]}
    other = result | {"protocol": result["protocol"] | {"draw_seed": 1}}
    for number, wrong in enumerate((easier, other)):
        path = tmp_path / f"{number}.json"
        path.write_text(json.dumps(wrong))
        with pytest.raises(RenetError, match="the same settings"):
            make_leaderboard(LeaderboardCfg((folder / "result.json", path)))


def test_a_damaged_file_is_refused_and_versions_do_not_share_a_table(folder, tmp_path):
    result = read_result(folder / "result.json")
    del result["scores"]
    (tmp_path / "damaged.json").write_text(json.dumps(result))
    with pytest.raises(RenetError, match=r"'scores' is a required property \(see docs/crossing"):
        read_result(tmp_path / "damaged.json")
    (tmp_path / "old.json").write_text(json.dumps(complete("old", 0.5)))
    with pytest.raises(RenetError, match="one version"):
        make_leaderboard(LeaderboardCfg((folder / "result.json", tmp_path / "old.json")))


def test_other_conditions_give_no_result_file(tmp_path, monkeypatch):
    monkeypatch.setattr(OneTryStudy, "run", lambda self, evaluator: {})
    CrossingStudy(out=tmp_path, conditions="training").run()
    assert not (tmp_path / "result.json").exists()


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"conditions": "easy"}, "conditions"),
        ({"grounds": ("flat",)}, "choose among gap, platform"),
        ({"draw_seed": -1}, "draw seed must be at least 0"),
        ({"seconds": 0.5}, "seconds must be at least 1"),
    ],
)
def test_settings_that_measure_nothing_are_refused(wrong, message):
    with pytest.raises(RenetError, match=message):
        CrossingStudy(**wrong)
