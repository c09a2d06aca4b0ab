import json
from dataclasses import replace
from pathlib import Path

import pytest

import speed
from renet.errors import RenetError

CFG = speed.Cfg("HEAD", rounds=2)


class Fake:
    """Stands in for `renet`: half the time now, and the curves of three iterations."""

    def __init__(self) -> None:
        self.commands: list[tuple[str, ...]] = []
        self.crossed = {"before": 3, "now": 3, "new": 3}

    def __call__(self, tree: Path, *arguments: str) -> tuple[float, float]:
        self.commands.append((tree.name, *arguments))
        seconds = 8.0 if tree.name == "before" else 4.0
        if arguments[0] == "train":
            run = Path(arguments[arguments.index("--log-root") + 1]) / "task" / "run"
            run.mkdir(parents=True)
            rows = [f"{n},Perf/total_fps,{v / seconds}" for n, v in enumerate((1, 800, 1600))]
            (run / "curves.csv").write_text("\n".join(["iteration,name,value", *rows]) + "\n")
        else:
            out = Path(arguments[arguments.index("--out") + 1])
            out.mkdir()
            summary = {"runs": self.crossed[tree.name], "provenance": tree.name, "settings": {}}
            (out / "summary.json").write_text(json.dumps(summary))
        return seconds, 2 * seconds


@pytest.fixture
def fake(monkeypatch) -> Fake:
    fake = Fake()
    monkeypatch.setattr(speed, "renet", fake)
    return fake


def test_both_commits_run_in_turn_and_are_compared(fake, tmp_path):
    runs = speed.measure({"before": Path("before"), "now": Path("now")}, CFG, tmp_path)
    assert [(tree, command) for tree, command, *_ in fake.commands[2:]] == [
        *[("before", "evaluate"), ("before", "train"), ("now", "evaluate"), ("now", "train")] * 2
    ]
    assert runs["before"] == speed.Runs([8.0] * 2, [16.0] * 2, [150.0] * 2)
    runs["now"].study_cpu_s[1] = 6.0
    ratios = speed.ratios(runs)
    assert ratios["study_cpu_s_ratio"] == 0.625
    assert ratios["study_cpu_s_ratio_spread"] == [0.5, 0.75]
    assert ratios["training_steps_per_s_ratio"] == 2.0


def test_other_results_are_an_error(fake, tmp_path):
    fake.crossed["now"] = 4
    cfg = replace(CFG, parts=("study",))
    with pytest.raises(RenetError, match="round 1, now: other results than before: runs"):
        speed.measure({"before": Path("before"), "now": Path("now")}, cfg, tmp_path)


def test_the_worktree_is_of_its_commit_and_temporary(tmp_path):
    with speed.worktree("HEAD") as tree:
        assert (tree / "benchmarks" / "engine.py").exists()
    assert not tree.exists()
    with (
        pytest.raises(RenetError, match="git cannot check out nonsense"),
        speed.worktree("nonsense"),
    ):
        pass


def test_commits_walk_in_nominal_conditions_and_old_ones_need_not_be_told(fake, tmp_path):
    new = tmp_path / "new"
    (new / "src/renet/evaluation").mkdir(parents=True)
    (new / "src/renet/evaluation/conditions.py").touch()
    speed.run_study(new, CFG, tmp_path / "a")
    speed.run_study(tmp_path / "before", CFG, tmp_path / "b")
    told = ["--conditions nominal" in " ".join(command) for command in fake.commands]
    assert told == [True, False]
