"""What a newcomer meets first: README, citation, change log, Dockerfile and notebook."""

import ast
import json
import re
import tomllib
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import numpy as np

import renet
from tests.test_doc_commands import parse
from tests.test_doc_numbers import percent, result

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def test_the_readme_has_500_words_at_most_and_two_commands():
    assert len(README.split()) <= 500
    commands = re.findall(r"```bash\n(.*?)```", README, re.DOTALL)
    assert len(commands) == 2
    assert all("-m venv .venv" in command and "pip install -c" in command for command in commands)
    assert "renet deploy" in commands[0]
    assert commands[1].endswith("&& pytest\n")


def test_python_of_the_readme_runs():
    scope: dict = {}
    exec(re.findall(r"```python\n(.*?)```", README, re.DOTALL)[0], scope)
    assert scope["action"].shape == (1, 12)
    assert scope["use_vision"].dtype == bool


def test_the_citation_is_that_of_the_citation_file():
    source = (ROOT / "CITATION.cff").read_text()
    names = re.findall(r"family-names: (\w+), given-names: (\w+)", source)
    (authors,) = re.findall(r"author += \{(.*?)\}", README, re.DOTALL)
    assert re.split(r"\s+and\s+", authors) == [f"{last}, {first}" for last, first in names]
    (title,) = re.findall(r"title += \{(.*?)\},\n", README, re.DOTALL)
    words = title.replace("{", "").replace("}", "").split()
    assert " ".join(words) in " ".join(source.split())


# The cells of the README's table beside the first, by the first.
LINES = re.findall(r"^\| (.+?) \| (.+?) \| (.+?) \| \[", README, re.MULTILINE)
ROWS = {name: cells for name, *cells in LINES}


def test_counts_of_the_readme_are_those_measured_on_stairs():
    """`renet evaluate faults --preset noise --grounds stairs_up --level 5 --onsets 1.5`."""
    stairs = result("shipped/stairs.json")
    crossed = {
        (row["mode"], row.get("fault"), row.get("severity")): row["measures"]["crossed"]["value"]
        for row in stairs["baseline"] + stairs["runs"]
    }
    noises = {(fault, severity) for _, fault, severity in crossed if fault}
    assert len(noises) == 6
    chosen = {
        "climb stairs of 13 cm, healthy camera": [(None, None)],
        "the same, Gaussian noise 70 %": [("gaussian", 4)],
        "the same, all six noises": sorted(noises),
    }
    for name, settings in chosen.items():
        counts = [sum(round(20 * crossed[mode, *s]) for s in settings) for mode in ("vp", "renet")]
        assert ROWS[name] == [f"{n} of {20 * len(settings)}" for n in counts]


def test_shares_of_the_readme_are_means_of_the_fault_benchmark():
    settings = result("leaderboard/go1-parkour.json")["settings"]
    for name, measure, ground in (
        ("stay upright under 29 camera faults", "upright", ""),
        ("cross obstacles under them", "crossed", "flat"),
    ):
        rows = [s for s in settings if s["ground"] != ground]
        modes = [[s for s in rows if s["mode"] == mode] for mode in ("vp", "renet")]
        assert ROWS[name] == [f"{percent(chosen, measure):.1f} %" for chosen in modes]
    assert len({s["fault"] for s in settings}) == 29


def test_the_change_log_knows_this_version():
    versions = re.findall(r"^## \[(.+?)\]", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert versions[0] == "Unreleased"
    assert renet.__version__ in versions


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
    for cell in book["cells"]:
        if cell["cell_type"] == "code":
            code = "".join(cell["source"])
            exec(compile(ast.parse(code), "walk.ipynb", "exec"), scope)
            assert not cell["outputs"]
    time, ticks = scope["time"], scope["ticks"]
    assert time[-1] >= 9.9
    dead = (time > 4.5) & (time < 9.9)
    assert ticks["vision"][dead].all()
    assert not ticks["has_image"][dead].any(), "VP walks on from memory"
    assert np.mean(scope["speed"][dead]) > 0.3, "and still walking"
    assert len(plt.gcf().axes) == 2
    plt.close("all")
