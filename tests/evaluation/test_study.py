"""What every study shares: recipe, presets on the command line, any registered robot."""

import json
import os
import runpy
import shutil
from dataclasses import replace
from math import inf, nan
from pathlib import Path

import pytest

from renet import cli
from renet.bundle import pretrained, read_manifest, write_manifest
from renet.errors import RenetError
from renet.evaluation.demo import DemoStudy
from renet.evaluation.env import terrain_env_cfg
from renet.evaluation.evaluator import Evaluator
from renet.evaluation.results import MAX_RESULT_SIZE, Provenance, read_results, write_summary
from renet.evaluation.settings import FLAT_GROUND
from renet.evaluation.studies.backing import BackingStudy
from renet.evaluation.studies.commands import CommandStudy
from renet.evaluation.studies.reach import ReachStudy
from renet.evaluation.studies.stops import StopsStudy
from renet.registry import register_tasks
from renet.tasks import VISUAL_GO1
from renet.tasks.sensors import DEPTH_CAMERA

from .counting import CountingStudy
from .fakes import SPEED, FakeEvaluator
from .tiny import STUDIES, TINY


@pytest.mark.parametrize(
    ("study", "settings", "words"),
    [
        (ReachStudy, {"modes": ("blind",)}, "evaluate memory --preset reach --modes blind"),
        (CommandStudy, {"speed": 1.0}, "evaluate commands --speed 1"),
    ],
)
def test_settings_that_change_nothing_are_refused(study, settings, words, tmp_path, capsys):
    """Results would name the mode or the speed, and be of another one."""
    *_, option, _ = words.split()
    with pytest.raises(RenetError, match=f"study {study.name} has no use for {option}: leave it"):
        study(tmp_path / "out", **settings)
    assert cli.main([*words.split(), "--out", str(tmp_path / "out")]) == 2
    command = words.partition(f" {option}")[0]
    expected = f"renet: `renet {command}` has no use for {option}: leave it out\n"
    assert capsys.readouterr().err == expected
    with pytest.raises(SystemExit):
        cli.main([*command.split(), "--help"])
    assert f"{option} " not in capsys.readouterr().out
    assert not (tmp_path / "out").exists()


def test_the_recipe_of_a_study_runs_and_goes_on(tmp_path, monkeypatch):
    monkeypatch.setattr(cli, "COMMANDS", dict(cli.COMMANDS))
    path = Path(__file__).parents[2] / "examples" / "add_study.py"
    recipe = runpy.run_path(str(path), run_name="recipe")
    study = recipe["SpeedStudy"](out=tmp_path / "deep" / "er")
    made: list[float] = []

    class Counting(FakeEvaluator):
        def make_env(self, task, robots, speed, seed):
            made.append(speed)
            if made == [0.3, 0.6]:
                raise KeyboardInterrupt
            return super().make_env(task, robots, speed, seed)

    with pytest.raises(KeyboardInterrupt):
        study.run(Counting())
    assert not (study.out / "summary.json").exists()
    summary = study.run(Counting())
    assert made == [0.3, 0.6, 0.6, 0.9], "only what is missing is run"
    assert [run["commanded"] for run in summary["runs"]] == [0.3, 0.6, 0.9]
    assert json.loads((study.out / "summary.json").read_text()) == summary
    assert (study.out / "summary.csv").read_text().count("\n") == 4
    assert replace(study, out=tmp_path / "whole").run(FakeEvaluator())["runs"] == summary["runs"]

    class Other(Counting):
        def make_policy(self, num_robots):
            return super().make_policy(num_robots)

    study.run(Other())
    assert made[4:] == [0.3, 0.6, 0.9], "another policy's results are not gone on with"
    damage = {'{"key": {}}': "of other settings than its name", '{"half': "not JSON"}
    for content, message in damage.items():
        for part in (study.out / "parts").glob("speed_0.3-*"):
            part.write_text(content)
        with pytest.raises(RenetError, match=rf"speed_0\.3-\w+\.json is {message}"):
            study.run(Other())
    assert study.tables(summary)[0][2][0] == (0.3, pytest.approx(SPEED), 0)


def test_a_damaged_part_is_told_before_others_are_made(tmp_path):
    study = CountingStudy(tmp_path)
    study.run()
    (first,) = (tmp_path / "parts").glob("a-*")
    (last,) = (tmp_path / "parts").glob("e-*")
    whole = last.read_bytes()
    first.unlink()
    last.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(RenetError, match=r"e-\w+\.json is not JSON.* delete it"):
        study.run()
    assert not first.exists()
    last.unlink()
    study.run()
    assert json.loads(last.read_text())["number"] == ord("e")


def test_the_conditions_of_a_given_evaluator_are_stated_and_kept_apart(tmp_path):
    study = replace(TINY["memory"], out=tmp_path, conditions="training")
    evaluator = FakeEvaluator()
    evaluator.conditions = "nominal"
    assert study.run(evaluator)["settings"]["conditions"] == "nominal"
    parts = list(study.part_maker(evaluator).makers)
    assert study.part_maker(evaluator).missing(parts) == []
    evaluator.conditions = "training"
    assert study.part_maker(evaluator).missing(parts) == parts


@pytest.mark.parametrize(
    ("part", "change"),
    [("camera", {"noise_std": 0.02}), ("provenance", {"task": "Renet-Go1-Flat"})],
)
def test_a_bundle_with_another_camera_or_task_makes_all_parts_anew(tmp_path, part, change):
    folder = tmp_path / "bundle"
    shutil.copytree(pretrained("go1-parkour"), folder)
    study = replace(TINY["memory"], out=tmp_path / "out", bundle=folder)
    parts = study.part_maker()
    for name in parts.makers:
        parts.makers[name] = lambda: {"runs": []}
        parts(name)
    assert study.part_maker().missing(parts.makers) == []
    manifest = read_manifest(folder)
    write_manifest(folder, replace(manifest, **{part: replace(getattr(manifest, part), **change)}))
    assert study.part_maker().missing(parts.makers) == list(parts.makers)


def test_presets_are_chosen_on_the_command_line(capsys):
    folders = {"faults": "faults", "faults --preset noise": "noise"}
    folders |= {"terrain --preset=success": "success", "terrain --preset standing": "standing"}
    for words, folder in folders.items():
        with pytest.raises(SystemExit):
            cli.main(["evaluate", *words.split(), "--help"])
        assert f"results/{folder}" in capsys.readouterr().out.replace("\n", "")
    assert cli.main(["evaluate", "faults", "--preset", "rain"]) == 2
    assert "unknown preset 'rain': choose one of noise" in capsys.readouterr().err
    assert cli.main(["evaluate", "faults", "--preset"]) == 2


def test_a_study_walks_the_bundles_own_robot_whose_cameras_err_as_in_training(tmp_path):
    register_tasks("Twin", replace(VISUAL_GO1, name="Somebody's Go1"))
    shutil.copytree(pretrained("go1-parkour"), tmp_path / "twin")
    manifest = read_manifest(tmp_path / "twin")
    robot = replace(manifest.robot, name="Somebody's Go1")
    origin = replace(manifest.provenance, task="Renet-Twin-Flat")
    camera = replace(manifest.camera, noise_std=0.02)
    twin = replace(manifest, robot=robot, provenance=origin, camera=camera)
    write_manifest(tmp_path / "twin", twin)
    evaluator = Evaluator(tmp_path / "twin")
    for terrain in (FLAT_GROUND, {"stairs_up": 3}):
        assert terrain_env_cfg(terrain, evaluator.robot).robot.name == "Somebody's Go1"
    env = evaluator.make_env(FLAT_GROUND, range(2), 0.6, 1)
    assert env.env.cfg.robot.name == "Somebody's Go1"
    assert env.env.scene[DEPTH_CAMERA].cfg.noise.gaussian_std == 0.02
    refusal = "bundle twin drives a Somebody's Go1, this task's robot is a Unitree Go1"
    with pytest.raises(RenetError, match=refusal):
        evaluator.make_env("Renet-Go1-Flat", range(2), 0.6, 1)


def test_the_summary_for_people_holds_tables_figures_and_provenance(run_study):
    folder, summary = run_study("faults")
    text = (folder / "summary.md").read_text()
    assert text.startswith("# faults\n\n## Robots that cross (%)\n\n| ground | fault | camera |")
    for name in ("crossed.png", "survival.png", "detection.png"):
        assert f"![{name}]({name})" in text
        assert (folder / name).exists()
    assert f"| bundle hash | {'0' * 64} |" in text
    assert f"| seed | {summary['settings']['seed']} |" in text


def test_names_in_a_summary_are_no_markup(tmp_path):
    origin = Provenance("[x](javascript:1)|<b>\x1b[31m", "", "native", 1)
    write_summary(tmp_path / "summary.md", "a|b", [("T", ("one",), [("<i>",)])], [], origin)
    text = (tmp_path / "summary.md").read_text()
    for expected in ("# a\\|b", "\\<i\\>", "\\[x\\](javascript:1)\\|\\<b\\>"):
        assert expected in text
    assert "\x1b" not in text


LAVA = ("lava",)
WRONG: dict[str, dict[str, list]] = {
    "faults": {
        "faults": [("smoke",), ("gaussian:9",), ("gaussian:x",), ()],
        "modes": [("vp",), (), ("blind",) * 2],
        "healthy_minutes": [-1.0, nan, inf],
        "seconds": [nan, inf],
        **{"severities": [(0,)], "onsets": [(0.5, 8.0)], "grounds": [LAVA], "level": [11]},
        **{"speed": [0.0], "robots": [0]},
    },
    "margins": {"axes": [("luck",)], "grounds": [LAVA, ()], "level": [0], "seconds": [inf]},
    "standing": {"kinds": [LAVA], "modes": [("x",)], "levels": [(11,)], "seconds": [0, inf]},
    "success": {"kinds": [LAVA], "levels": [(0,), (), (1, 1)], "fault": ["gremlins", "frozen:9"]},
    "terrain": {"kinds": [()], "robots": [0], "modes": [("x",), ("camera",) * 2], "seconds": [inf]},
}
"""Any one of these values is refused, with all others at their defaults."""
OTHERS = {
    "backing": BackingStudy,
    "commands": CommandStudy,
    "demo": DemoStudy,
    "reach": ReachStudy,
    "stops": StopsStudy,
}


@pytest.mark.parametrize(
    ("study", "wrong", "message"),
    [
        *(
            (study, {name: value}, None)
            for study, names in WRONG.items()
            for name, values in names.items()
            for value in values
        ),
        ("faults", {"faults": ("glass",), "grounds": ("flat", "gap")}, None),
        ("success", {"speed": -0.6, "fault": "foam"}, None),
        ("noise", {"grounds": ("flat", "gap")}, None),
        ("memory", {"grounds": ("gap",)}, "ground 'gap': write KIND:LEVEL"),
        ("memory", {"grounds": ("moon:3",)}, "ground 'moon:3'"),
        ("memory", {"grounds": ("gap:11",)}, "1 to 10"),
        ("memory", {"grounds": ()}, "give a ground"),
        ("memory", {"without": (0.0, 1.0)}, "give times above 0 s"),
        ("memory", {"without": (1.0, 1.0)}, "without has 1.0 more than once: give it once"),
        ("success", {"kinds": ("gap", "gap")}, "kinds has gap more than once"),
        ("faults", {"grounds": ("gap", "flat", "gap")}, "grounds has gap more than once"),
        ("margins", {"axes": ("gyro", "gyro")}, "axes has gyro more than once"),
        ("reach", {"metres": (1.1, 1.1)}, "metres has 1.1 more than once"),
        ("memory", {"before": -1.0}, "before must be at least 0 s"),
        ("memory", {"speed": 0.08}, "no image is missing within 12"),
        ("demo", {"seconds": 0.0}, None),
        ("demo", {"seconds": 1.0}, "seconds must be above"),
        ("demo", {"speed": 0.1}, "seconds must be above"),
        ("commands", {"seconds": 2.0}, "seconds must exceed 2"),
        ("backing", {"kinds": ("platform",)}, "choose among gap, stairs_up, stairs_down"),
        ("backing", {"speed": 0.7}, "speed must be at most 0.6 m/s backward"),
        ("backing", {"from_edge": 1.3}, "from-edge 1.3 m is not on the ground"),
        ("reach", {"unseen": ("fly",)}, "unseen"),
        ("reach", {"metres": ()}, "at least one"),
        ("reach", {"metres": (0.0,)}, "above 0"),
        ("reach", {"metres": (3.5,)}, "do not fit"),
        ("stops", {"kinds": ("gap",)}, "choose among wall, ledge"),
        ("stops", {"height": 0.0}, "height must be positive"),
        ("camera_use", {"grounds": ("gap",)}, "write KIND:LEVEL, of flat, rough"),
        ("camera_use", {"robots": 1}, "at least 2 robots"),
        ("camera_use", {"speed": 0.0}, "speed must be positive"),
        ("camera_use", {"modes": ("both",)}, "modes both"),
        ("camera_use", {"modes": ("camera", "blind")}, "one mode"),
    ],
)
def test_settings_that_measure_nothing_are_refused(study, wrong, message):
    with pytest.raises(RenetError, match=message):
        (STUDIES | OTHERS)[study](**wrong)


def test_files_that_are_no_results_are_refused(tmp_path):
    huge = tmp_path / "huge.json"
    huge.touch()
    os.truncate(huge, MAX_RESULT_SIZE + 1)
    wrong = {huge: "at most 64 MB", tmp_path: "s a directory", tmp_path / "x": "run"}
    for path, message in wrong.items():
        with pytest.raises(RenetError, match=message):
            read_results(path)
