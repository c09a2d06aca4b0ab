"""What a newcomer meets first: README, citation, change log, Dockerfile and notebook."""

import ast
import json
import re
import tomllib
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from scipy.stats import binomtest

import renet
from tests.test_doc_commands import parse

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def test_folders_of_the_readme_tree_exist():
    tree = README.split("src/renet/\n")[1].split("tests/ mirrors")[0]
    names = re.findall(r"^  (\S+)", tree, re.MULTILINE) + re.findall(r"([a-z]+/[a-z]+/)", tree)
    assert len(names) > 12
    assert not [name for name in names if not (ROOT / "src" / "renet" / name).exists()]


def test_commands_to_run_it_and_to_test_it_stand_in_the_readme():
    assert "-e '.[sim]'\nrenet deploy" in README
    assert "-e '.[train,dev]' && pytest`" in README


def test_counts_in_the_readme_are_those_measured_with_exact_intervals():
    page = (ROOT / "docs" / "pretrained.md").read_text()
    measured = page.split("### Stairs and a camera that fails")[1]
    rows = {
        "no fault": "no noise",
        "Gaussian noise 70 %": "Gaussian 70 %",
        "salt and pepper 30 %": "salt and pepper 30 %",
    }
    for shown, source in rows.items():
        line = re.search(rf"^\| .*, {shown}.*$", README, re.MULTILINE)
        original = re.search(rf"^\| {source} \|.*$", measured, re.MULTILINE)
        assert line
        assert original
        counts = re.findall(r"(\d+) of (\d+) \((\d+) to (\d+) %\)", line[0])
        assert [c[:2] for c in counts] == re.findall(r"(\d+) of (\d+)", original[0])
        for k, n, low, high in (map(int, c) for c in counts):
            exact = binomtest(k, n).proportion_ci(0.95, "exact")
            assert (low, high) == (round(100 * exact.low), round(100 * exact.high))
    hours = re.search(r"0 in ([\d.]+) h \(95 % limit ([\d.]+) per hour\)", README)
    assert hours
    assert f"0 false switches in {hours[1]} robot hours" in page
    # Exact Poisson limit of no event: exp(-limit * hours) is 5 %.
    assert float(hours[2]) == round(-np.log(0.05) / float(hours[1]), 1)


def test_the_change_log_knows_this_version():
    versions = re.findall(r"^## \[(.+?)\]", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert versions[0] == "Unreleased"
    assert renet.__version__ in versions


def test_the_dockerfile_installs_an_extra_and_runs_a_command():
    text = (ROOT / "Dockerfile").read_text()
    extra = re.search(r"^RUN pip install .*'\.\[(\w+)\]'$", text, re.MULTILINE)
    assert extra
    assert extra[1] in PROJECT["optional-dependencies"]
    for copied in re.findall(r"^COPY (.+) \S+$", text, re.MULTILINE):
        assert all((ROOT / name).exists() for name in copied.split())
    command = json.loads(re.findall(r"^CMD (.+)$", text, re.MULTILINE)[0])
    assert command[0] in PROJECT["scripts"]
    assert parse(command[1:]).robot == "mujoco"


@pytest.fixture
def figures(monkeypatch, tmp_path):
    import matplotlib.pyplot as plt

    matplotlib.use("Agg")
    monkeypatch.chdir(tmp_path)
    yield plt
    plt.close("all")


def test_the_notebook_walks_and_plots(figures):
    book = json.loads((ROOT / "examples" / "walk.ipynb").read_text())
    scope: dict = {}
    for cell in book["cells"]:
        if cell["cell_type"] == "code":
            code = "".join(cell["source"])
            exec(compile(ast.parse(code), "walk.ipynb", "exec"), scope)
            assert not cell["outputs"]
    time, ticks = scope["time"], scope["ticks"]
    assert time[-1] >= 9.9
    assert not ticks["vision"][time > 4.5].any(), "blind from 4 s on"
    assert np.mean(scope["speed"][(time > 6.0) & (time < 9.9)]) > 0.3, "and still walking"
    assert len(figures.gcf().axes) == 2
