"""What a newcomer meets first: README, citation, change log, Dockerfile and notebook."""

import json
import re
import tomllib
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import numpy as np

import renet
from tests.test_doc_commands import parse
from tests.test_doc_numbers import result

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def test_python_of_the_readme_runs():
    scope: dict = {}
    exec(re.findall(r"```python\n(.*?)```", README, re.DOTALL)[0], scope)
    assert scope["step"].joint_target.shape == (1, 12)
    assert scope["step"].state[0] == "remembers"


def test_the_citation_is_that_of_the_citation_file():
    source = (ROOT / "CITATION.cff").read_text()
    names = re.findall(r"family-names: (\w+), given-names: (\w+)", source)
    (article,) = re.findall(r"@article\{.*?\n\}", README, re.DOTALL)
    (authors,) = re.findall(r"author += \{(.*?)\}", article, re.DOTALL)
    assert re.split(r"\s+and\s+", authors) == [f"{last}, {first}" for last, first in names]
    (title,) = re.findall(r"title += \{(.*?)\},\n", article, re.DOTALL)
    words = title.replace("{", "").replace("}", "").split()
    assert " ".join(words) in " ".join(source.split())
    (software,) = re.findall(r"@software\{.*?\n\}", README, re.DOTALL)
    (title,) = re.findall(r"^title: \"(.+)\"$", source, re.MULTILINE)
    assert f"{{{title}}}" in software
    assert f"version = {{{renet.__version__}}}" in software


# The numbers of the README's table by obstacle and file of results.
LINES = re.findall(r"^\| \[(.+?)\]\((.+?)\) \| (.+) \|$", README, re.MULTILINE)


def test_numbers_of_the_readme_are_those_of_the_studies():
    assert len(LINES) == 5
    for obstacle, path, cells in LINES:
        study = json.loads((ROOT / path).read_text())
        assert study["settings"]["robots"] == 100
        (size,) = re.findall(r"gap of (\d+) cm", obstacle)
        passed = {
            run["mode"]: str(run["passed"])
            for run in study["runs"]
            if round(100 * run["size_m"]) == int(size)
        }
        assert cells.split(" | ") == [
            passed[mode] for mode in ("camera", "switch", "blind", "memory")
        ]


def test_counts_under_the_film_are_those_of_the_table():
    demo = result("shipped/demo.json")
    gap = f"gap of {100 * demo['gap_m']:.0f} cm"
    counts = r" which (\d+) of 100 robots cross with `switch` and (\d+) with `memory`"
    (pair,) = re.findall(rf"unplugged before a {gap},{counts}", " ".join(README.split()))
    (cells,) = (cells for obstacle, _, cells in LINES if obstacle == f"{gap}, unplugged")
    _, switch, _, memory = cells.split(" | ")
    assert pair == (switch, memory)
    assert demo["runs"][0]["robots"] == 20


def test_the_dockerfile_installs_an_extra_and_runs_a_command():
    text = (ROOT / "Dockerfile").read_text()
    (extra,) = re.findall(r"^RUN pip install .*'\.\[(\w+)\]'$", text, re.MULTILINE)
    assert extra in PROJECT["optional-dependencies"]
    for copied in re.findall(r"^COPY (.+) \S+$", text, re.MULTILINE):
        assert all((ROOT / name).exists() for name in copied.split())
    command = json.loads(re.findall(r"^CMD (.+)$", text, re.MULTILINE)[0])
    assert command[0] in PROJECT["scripts"]
    assert parse(command[1:]).robot == "mujoco"


def test_the_notebook_walks_and_plots(monkeypatch, tmp_path):
    matplotlib.use("Agg")
    monkeypatch.chdir(tmp_path)
    book = json.loads((ROOT / "examples" / "walk.ipynb").read_text())
    scope: dict = {}
    for cell in (cell for cell in book["cells"] if cell["cell_type"] == "code"):
        exec("".join(cell["source"]), scope)
        assert not cell["outputs"]
    assert scope["step"].state[0] == "remembers"
    time, ticks = scope["time"], scope["ticks"]
    assert time[-1] >= 9.9
    dead = (time > 4.5) & (time < 9.9)
    assert ticks["vision"][dead].all()
    assert not ticks["has_image"][dead].any(), "VP walks on from memory"
    assert np.mean(scope["speed"][dead]) > 0.3, "and still walking"
    assert len(plt.gcf().axes) == 2
    plt.close("all")
