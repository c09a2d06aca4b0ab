"""Result files of benchmarks, and what their commands say of a mistake."""

import json
import runpy
import sys
from pathlib import Path

import pytest

from facts import report
from renet.errors import RenetError

BENCHMARKS = Path(__file__).parents[1]


def test_the_folder_of_a_result_file_is_made(tmp_path, capsys):
    path = tmp_path / "results" / "depth.json"
    report({"rays": 2.5, "rows": [1, 2]}, path)
    written = json.loads(path.read_text())
    assert written.pop("facts")["cpus"] > 0
    assert written == {"rays": 2.5, "rows": [1, 2]}
    shown = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert shown == [["rays", "2.5"], ["rows", "2", "rows"]]


def test_a_result_file_that_cannot_be_written_is_named(tmp_path):
    with pytest.raises(RenetError, match=f"cannot write the results {tmp_path}"):
        report({}, tmp_path)
    assert [*tmp_path.iterdir()] == []


@pytest.mark.parametrize(
    ("script", "options", "message"),
    [
        ("runtime", "--bundle nowhere", "no bundle at nowhere"),
        ("switching", "--terrains moon", "unknown terrain 'moon'"),
        ("switching", "--seeds 0", "at least 1, got 0"),
        ("switching", "--seconds 3 --seeds 1 --terrains flat", "no estimator switched on flat"),
        ("soak", "--terrain moon", "unknown terrain 'moon'"),
        ("soak", "--plot soak.png", "give --json, too"),
        ("soak", "--plot soak.png --json soak.json --minutes 0.5", "whole minutes"),
        ("soak", "--plot soak.png --json soak.json --minutes 0", "cannot read the results"),
        ("hardware_faults", "--bundle nowhere", "no bundle at nowhere"),
        ("hardware_faults", "--motors go1", "ideal motors"),
        ("mutation", "--parts none", "unknown part 'none'"),
        ("mutation", "--parts np3o --again", "no result of np3o"),
        ("recipe_curves", "nowhere", "nowhere/config.json"),
    ],
)
def test_a_mistake_is_told_in_one_line(script, options, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [script, *options.split()])
    with pytest.raises(SystemExit) as end:
        runpy.run_path(str(BENCHMARKS / f"{script}.py"), run_name="__main__")
    assert end.value.code == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert said.startswith(f"{script}: ")
    assert message in said
    assert [*tmp_path.iterdir()] == []
