"""The command: settings, parts, results, and the verification of a result."""

import json
from dataclasses import replace

import pytest

from renet.cli import main
from renet.errors import RenetError
from renet.evaluation.benchmark import study as benchmark_study
from renet.evaluation.benchmark.episodes import draw_episodes
from renet.evaluation.benchmark.results import read_result
from renet.evaluation.benchmark.study import BenchmarkStudy
from renet.evaluation.results import write_json

from ..fakes import FakeEvaluator
from .rows import row


class Walked(BenchmarkStudy):
    """Crosses everything but in every third episode, without walking."""

    def walk_block(self, evaluator, first):
        episodes = draw_episodes(range(first, first + 10), self.draw_seed)
        return {
            "rows": [
                row(
                    episode.number,
                    0 if episode.number % 3 == 0 else len(episode.obstacles),
                    obstacles=len(episode.obstacles),
                    entry=entry,
                )
                for entry in self.modes(evaluator)
                for episode in episodes
            ]
        }

    def make_evaluator(self):
        return FakeEvaluator()


@pytest.fixture
def study(tmp_path):
    return Walked(out=tmp_path, quick=True, entries=("memory", "blind"), method="ours")


def test_a_run_leaves_a_result_that_can_be_read(study, tmp_path):
    study.run()
    result = read_result(tmp_path / "result.json")
    assert result["episodes"] == "quick"
    assert result["policy"]["method"] == "ours"
    assert result["scores"]["memory"]["score"] == pytest.approx(13 / 20)
    assert len(result["rows"]) == 40


def test_the_tables_have_a_line_for_each_entry(study):
    ranking, measures, counts, families = study.tables(study.run())
    assert [line[2] for line in ranking[2]] == ["memory", "blind"]
    assert [line[1] for line in measures[2]] == ["memory", "blind"]
    assert [line[0] for line in counts[2]] == ["memory", "blind"]
    assert [name for name, *_ in families[2]] == ["dark", "mount"]


def test_other_draws_leave_no_result(study, tmp_path):
    study.run()
    replace(study, draw_seed=9).run()
    assert not (tmp_path / "result.json").exists()


def test_a_full_run_takes_over_what_a_quick_one_walked(study, tmp_path, monkeypatch):
    study.run()
    walked = []
    walk = Walked.walk_block
    monkeypatch.setattr(
        Walked, "walk_block", lambda self, e, first: walked.append(first) or walk(self, e, first)
    )
    replace(study, quick=False).run()
    assert walked == list(range(20, 200, 10))
    assert read_result(tmp_path / "result.json")["episodes"] == "full"


def test_a_short_run_is_never_ranked_and_later_taken_over(study, tmp_path, monkeypatch):
    short = replace(study, quick=False, episodes=10)
    summary = short.run()
    assert {run["episode"] for run in summary["runs"]} == set(range(10))
    assert not (tmp_path / "result.json").exists()
    assert "first 10 of 200 episodes" in short.tables(summary)[0][0]
    walked = []
    walk = Walked.walk_block
    monkeypatch.setattr(
        Walked, "walk_block", lambda self, e, first: walked.append(first) or walk(self, e, first)
    )
    study.run()
    assert walked == [10]
    assert read_result(tmp_path / "result.json")["episodes"] == "quick"


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"entries": ("memory", "memory")}, "entries has memory more than once: give it once"),
        ({"entries": ("renet",)}, "unknown entry 'renet': choose among memory"),
        ({"conditions": "training"}, "has no use for --conditions: leave it out$"),
        ({"seed": 2, "motors": "go1"}, "has no use for --seed and --motors: leave it out$"),
        ({"verify": "r.json", "quick": True}, "--verify walks ten episodes .* leave out --quick$"),
        ({"verify": "r.json", "draw_seed": 5, "shard": "1/2"}, "leave out --draw-seed and --shard"),
        ({"policy": "x.onnx"}, "give --policy FILE and --adapter together"),
        ({"policy": "x", "adapter": "himloco", "bundle": "b"}, "not both"),
        ({"draw_seed": -1}, "draw seed must be at least 0"),
        ({"sealed": "x", "quick": True}, "give --sealed or --quick"),
        ({"sealed": "x", "draw_seed": 5}, "not those of version 3"),
        ({"episodes": 5}, "multiple of 10 up to 200, got 5"),
        ({"episodes": 0}, "multiple of 10 up to 200, got 0"),
        ({"episodes": 210}, "multiple of 10 up to 200, got 210"),
        ({"episodes": 10, "quick": True}, "give --episodes without --quick"),
    ],
)
def test_wrong_settings_are_told(settings, message):
    with pytest.raises(RenetError, match=message) as error:
        BenchmarkStudy(**settings)
    assert "\n" not in str(error.value)


def test_a_wrong_policy_is_one_line_on_the_command_line(tmp_path, capsys):
    (tmp_path / "bad.onnx").write_bytes(b"no")
    words = ["--policy", str(tmp_path / "bad.onnx"), "--adapter", "playground"]
    assert main(["evaluate", "benchmark", *words, "--out", str(tmp_path / "out")]) == 2
    told = capsys.readouterr().err
    assert told.startswith("renet: ")
    assert told.count("\n") == 1
    assert "is no ONNX model" in told


@pytest.fixture
def claimed(study, tmp_path):
    study.run()
    return tmp_path / "result.json"


def test_a_true_result_holds(study, claimed):
    assert "20 of 20 walks end as the file says" in study.verify_result(claimed)


def test_the_verdict_is_the_commands_last_line(claimed, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    verifying = Walked(entries=("memory", "blind"), verify=claimed)
    assert "walks end as the file says" in str(verifying.main())
    assert not verifying.out.exists()


@pytest.mark.parametrize("words", [["--seed", "1"], ["--conditions=nominal"], ["--motors", "go1"]])
def test_options_without_use_are_hidden_and_refused_in_one_line(words, capsys):
    option = words[0].partition("=")[0]
    with pytest.raises(SystemExit):
        main(["evaluate", "benchmark", "--help"])
    told = capsys.readouterr().out
    assert "--draw-seed" in told
    assert option not in told
    assert main(["evaluate", "benchmark", *words]) == 2
    error = capsys.readouterr().err
    assert error == f"renet: `renet evaluate benchmark` has no use for {option}: leave it out\n"


def test_a_polished_result_does_not_hold(study, claimed):
    content = json.loads(claimed.read_text())
    for line in content["rows"]:
        line["crossed"] = line["obstacles"]
    write_json(claimed, content)
    with pytest.raises(RenetError, match=r"does not hold: of episodes .* walks end otherwise"):
        study.verify_result(claimed)


def test_a_tenth_of_the_walks_may_differ(study, claimed, monkeypatch):
    monkeypatch.setattr(benchmark_study, "chosen_block", lambda result: 10)
    content = json.loads(claimed.read_text())
    for number in (11, 12):
        content["rows"][number]["fell"] = not content["rows"][number]["fell"]
    write_json(claimed, content)
    assert "18 of 20 walks" in study.verify_result(claimed)
    content["rows"][13]["fell"] = not content["rows"][13]["fell"]
    write_json(claimed, content)
    with pytest.raises(RenetError, match="3 of 20 walks end otherwise, the first in episode 11"):
        study.verify_result(claimed)


def test_a_result_without_the_policys_entries_is_refused(study, claimed):
    with pytest.raises(RenetError, match="has none of the entries camera, healthy"):
        replace(study, entries=("camera", "healthy")).verify_result(claimed)


def test_a_result_of_another_policy_is_refused(study, claimed):
    content = json.loads(claimed.read_text())
    content["policy"]["sha256"] = "f" * 64
    write_json(claimed, content)
    with pytest.raises(RenetError, match="is of the policy ffffffffffff"):
        study.verify_result(claimed)
