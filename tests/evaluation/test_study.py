"""What every study shares: recipe, presets on the command line, any registered robot."""

import json
import runpy
import shutil
from dataclasses import replace
from math import inf, nan
from pathlib import Path

import pytest

from renet import cli
from renet.bundle import pretrained, read_manifest, write_manifest
from renet.errors import RenetError
from renet.evaluation.env import FLAT, terrain_env_cfg
from renet.evaluation.evaluator import Evaluator
from renet.evaluation.results import MAX_JSON, read_results
from renet.evaluation.studies.camera_use import CameraUseStudy
from renet.evaluation.studies.faults import FaultStudy
from renet.evaluation.studies.margins import MarginsStudy
from renet.evaluation.studies.memory import MemoryStudy
from renet.evaluation.studies.noise import NoiseStudy
from renet.evaluation.studies.standing import StandingStudy
from renet.evaluation.studies.terrain import SuccessStudy, TerrainStudy
from renet.evaluation.study import Study
from renet.registry import register_tasks
from renet.tasks.config.go1 import GO1

from .fakes import SPEED, FakeEvaluator

EXAMPLES = Path(__file__).parents[2] / "examples"


def test_the_recipe_of_a_study_runs_and_goes_on(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(cli, "COMMANDS", dict(cli.COMMANDS))
    recipe = runpy.run_path(str(EXAMPLES / "add_study.py"), run_name="recipe")
    study = recipe["SpeedStudy"](out=tmp_path)
    summary = study.run(FakeEvaluator())
    assert [run["commanded"] for run in summary["runs"]] == [0.3, 0.6, 0.9]
    assert summary["runs"][0]["speed"] == pytest.approx(SPEED, abs=1e-6)
    assert json.loads((tmp_path / "summary.json").read_text()) == summary
    assert (tmp_path / "summary.csv").read_text().count("\n") == 4
    next((tmp_path / "parts").glob("speed_0.6-*")).unlink()
    made: list[float] = []

    class Counting(FakeEvaluator):
        def make_env(self, task, robots, speed, seed):
            made.append(speed)
            return super().make_env(task, robots, speed, seed)

    class Other(Counting):
        def make_policy(self, num_robots):
            return super().make_policy(num_robots)

    study.run(Counting())
    assert made == [0.6], "only what is missing is run"
    study.run(Other())
    assert made == [0.6, 0.3, 0.6, 0.9], "another policy's results are not gone on with"
    for part in (tmp_path / "parts").glob("speed_0.3-*"):
        part.write_text(part.read_text().replace('"seed": 1', '"seed": 2'))
    with pytest.raises(RenetError, match="is of other settings than its name says"):
        study.run(Other())
    assert study.tables(summary)[0][2][0] == (0.3, pytest.approx(SPEED), 0)


def test_presets_are_chosen_on_the_command_line(capsys) -> None:
    for words, default in (
        (["faults", "--preset", "noise"], "results/noise"),
        (["faults"], "results/faults"),
        (["terrain", "--preset=success"], "results/success"),
        (["terrain", "--preset", "standing"], "results/standing"),
    ):
        with pytest.raises(SystemExit):
            cli.main(["evaluate", *words, "--help"])
        assert default in capsys.readouterr().out.replace("\n", "")
    assert cli.main(["evaluate", "faults", "--preset", "rain"]) == 2
    assert "unknown preset 'rain': choose one of noise" in capsys.readouterr().err
    assert cli.main(["evaluate", "faults", "--preset"]) == 2


def test_a_study_walks_the_bundles_own_robot(tmp_path: Path) -> None:
    register_tasks("Twin", replace(GO1, name="Somebody's Go1"))
    shutil.copytree(pretrained("go1-parkour"), tmp_path / "twin")
    manifest = read_manifest(tmp_path / "twin")
    robot = replace(manifest.robot, name="Somebody's Go1")
    origin = replace(manifest.provenance, task="Renet-Twin-Flat")
    write_manifest(tmp_path / "twin", replace(manifest, robot=robot, provenance=origin))
    evaluator = Evaluator(tmp_path / "twin")
    for terrain in (FLAT, {"stairs_up": 3}):
        assert terrain_env_cfg(terrain, evaluator.robot).robot.name == "Somebody's Go1"
    env = evaluator.make_env(FLAT, range(2), 0.6, 1)
    assert env.env.cfg.robot.name == "Somebody's Go1"
    refusal = "bundle twin drives a Somebody's Go1, this task's robot is a Unitree Go1"
    with pytest.raises(RenetError, match=refusal):
        evaluator.make_env("Renet-Go1-Flat", range(2), 0.6, 1)


LAVA = ("lava",)
WRONG: dict[type[Study], dict[str, list]] = {
    FaultStudy: {
        "faults": [("smoke",), ("gaussian:9",), ("gaussian:x",), ()],
        "modes": [("blind",), (), ("op",)],
        "healthy_minutes": [-1.0, nan, inf],
        "seconds": [nan, inf],
        **{"severities": [(0,)], "onsets": [(0.5, 8.0)], "grounds": [LAVA], "level": [11]},
        **{"speed": [0.0], "robots": [0], "selector": ["coin"]},
    },
    MarginsStudy: {"axes": [("luck",)], "grounds": [LAVA, ()], "level": [0], "seconds": [inf]},
    StandingStudy: {"kinds": [LAVA], "modes": [("x",)], "levels": [(11,)], "seconds": [0, inf]},
    SuccessStudy: {
        "kinds": [LAVA],
        "levels": [(0,), (), (1, 1)],
        "fault": ["gremlins", "frozen:9"],
    },
    TerrainStudy: {"kinds": [()], "robots": [0], "modes": [("x",), ("vp",) * 2], "seconds": [inf]},
}
"""Any one of these values is refused, with all others at their defaults."""


@pytest.mark.parametrize(
    ("study", "wrong"),
    [
        *(
            (study, {name: value})
            for study, names in WRONG.items()
            for name, values in names.items()
            for value in values
        ),
        (FaultStudy, {"faults": ("glass",), "grounds": ("flat", "gap")}),
        (SuccessStudy, {"speed": -0.6, "fault": "foam"}),
        (NoiseStudy, {"grounds": ("flat", "gap")}),
    ],
)
def test_bad_settings_are_refused(study: type[Study], wrong: dict) -> None:
    with pytest.raises(RenetError):
        study(**wrong)


@pytest.mark.parametrize(
    ("study", "name", "value", "message"),
    [
        (MemoryStudy, "grounds", ("gap",), "ground 'gap': write KIND:LEVEL"),
        (MemoryStudy, "grounds", ("moon:3",), "ground 'moon:3'"),
        (MemoryStudy, "grounds", ("gap:11",), "1 to 10"),
        (MemoryStudy, "grounds", (), "give a ground"),
        (MemoryStudy, "without", (0.0, 1.0), "different times above 0 s"),
        (MemoryStudy, "without", (1.0, 1.0), "different times above 0 s"),
        (MemoryStudy, "before", -1.0, "before must be at least 0 s"),
        (CameraUseStudy, "grounds", ("gap",), "write KIND:LEVEL, of flat, rough"),
        (CameraUseStudy, "grounds", ("moon:3",), "moon"),
        (CameraUseStudy, "grounds", (), "give a ground"),
        (CameraUseStudy, "robots", 1, "at least 2 robots"),
        (CameraUseStudy, "speed", 0.0, "speed must be positive"),
        (CameraUseStudy, "modes", ("both",), "modes both"),
        (CameraUseStudy, "modes", ("vp", "op"), "one mode"),
        (CameraUseStudy, "grounds", ("stairs:3",), "write KIND:LEVEL"),
    ],
)
def test_settings_that_measure_nothing_are_named(study, name, value, message) -> None:
    with pytest.raises(RenetError, match=message):
        study(**{name: value})


def test_files_that_are_no_results_are_refused(tmp_path: Path) -> None:
    huge = tmp_path / "huge.json"
    with huge.open("wb") as file:
        file.truncate(MAX_JSON + 1)
    for path, message in (
        (huge, "at most 64 MB"),
        (tmp_path, "s a directory"),
        (tmp_path / "x", "run"),
    ):
        with pytest.raises(RenetError, match=message):
            read_results(path)
