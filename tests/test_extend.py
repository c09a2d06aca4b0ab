"""The recipes of docs/extend.md: each is one short file, and does what it says."""

import json
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from renet import cli
from renet.faults import FAULTS

ROOT = Path(__file__).parents[1]
FILES = ("add_reward", "add_fault", "go2", "add_study", "third_party_policy")


@pytest.fixture
def load(monkeypatch):
    monkeypatch.setattr(cli, "COMMANDS", dict(cli.COMMANDS))
    return import_module


@pytest.mark.parametrize("name", FILES)
def test_each_recipe_is_one_file_of_under_sixty_lines_that_the_page_names(name):
    lines = (ROOT / "examples" / f"{name}.py").read_text().splitlines()
    assert len(lines) < 60
    assert f"examples/{name}.py" in (ROOT / "docs" / "extend.md").read_text()


def test_the_added_reward_penalises_turning(load):
    from renet.tasks import make_env

    load("add_reward")
    env = make_env("Renet-Go1-Level-Flat", 2)
    env.reset()
    robot = env.scene["robot"]
    term = env.reward_manager.get_term_cfg("turning")
    assert term.weight < 0
    expected = robot.data.root_link_ang_vel_b[:, :2].square().sum(-1)
    np.testing.assert_allclose(term.func(env), expected)
    env.close()


def test_the_added_fault_spoils_a_run(load, tmp_path):
    module = load("add_fault")
    try:
        out = tmp_path / "fog"
        where = ["--out", str(out), "--seconds", "4", "--fault", "fog:5@3s"]
        assert module.main(["deploy", "--camera", "sim", *where]) == 0
        assert json.loads((out / "score.json").read_text())["falls"] == 0
        fog = module.Fog(0.5, [np.random.default_rng(0)])
        spoilt = fog.spoil(np.ones((48, 64)), 0, 0.0)
        assert spoilt.mean() == pytest.approx(0.5, abs=0.01)
    finally:
        FAULTS.pop("fog")


def test_the_added_study_runs_from_the_command_line(load, tmp_path):
    module = load("add_study")
    where = ["--out", str(tmp_path / "speeds"), "--robots", "2", "--seconds", "0.4"]
    assert module.main(["evaluate", "speeds", "--speeds", "0.3", "0.6", *where]) == 0
    summary = json.loads((tmp_path / "speeds" / "summary.json").read_text())
    assert [run["commanded"] for run in summary["runs"]] == [0.3, 0.6]
    assert (tmp_path / "speeds" / "speeds.png").exists()
