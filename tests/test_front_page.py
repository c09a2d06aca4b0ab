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


def test_the_readme_has_two_commands():
    commands = re.findall(r"```bash\n(.*?)```", README, re.DOTALL)
    assert len(commands) == 2
    assert all("-m venv .venv" in command and "pip install -c" in command for command in commands)
    assert "--terrain gap --level 5 --fault blackout@3.3s" in commands[0]
    assert commands[1].endswith("&& pytest\n")


def test_python_of_the_readme_runs():
    scope: dict = {}
    exec(re.findall(r"```python\n(.*?)```", README, re.DOTALL)[0], scope)
    assert scope["step"].joint_target.shape == (1, 12)
    assert scope["step"].state[0] == "remembers"


def test_the_citation_is_that_of_the_citation_file():
    source = (ROOT / "CITATION.cff").read_text()
    names = re.findall(r"family-names: (\w+), given-names: (\w+)", source)
    (authors,) = re.findall(r"author += \{(.*?)\}", README, re.DOTALL)
    assert re.split(r"\s+and\s+", authors) == [f"{last}, {first}" for last, first in names]
    (title,) = re.findall(r"title += \{(.*?)\},\n", README, re.DOTALL)
    words = title.replace("{", "").replace("}", "").split()
    assert " ".join(words) in " ".join(source.split())


# The cells of the README's table beside the first, by the first.
LINES = re.findall(r"^\| \[(.+?)\]\(.+?\) \| (.+?) \| (.+?) \| (.+?) \|$", README, re.MULTILINE)
ROWS = {name: cells for name, *cells in LINES}


def counts(runs: list[dict]) -> list[str]:
    """The cells of a row: how many cross, by mode."""
    crossed = {run["mode"]: f"{run['crossed']} of {run['robots']}" for run in runs}
    return [crossed[mode] for mode in ("camera", "oracle", "memory")]


def test_counts_of_the_readme_are_those_of_the_memory_study_and_of_the_demo():
    memory, demo = result("shipped/memory.json"), result("shipped/demo.json")
    gap = [run for run in memory["runs"] if (run["ground"], run["level"]) == ("gap", 5)]
    assert round(100 * gap[0]["size_m"]) == round(100 * demo["gap_m"]) == 37
    names = [name for name in ROWS if name.startswith(("leap", "the same"))]
    black = [[r for r in gap if r["without_s"] == seconds] for seconds in (0.0, 8.0)]
    expected = [*map(counts, black), counts(demo["runs"])]
    assert [ROWS[name] for name in names] == expected
    (left, right) = re.findall(r"pairs (\d+) left robots crossed and (\d+) right", README)[0]
    assert [f"{left} of 20", f"{right} of 20"] == [expected[2][0], expected[2][2]]
    assert memory["settings"]["before"] == demo["before_s"] == 0.5


def test_speeds_of_the_readme_are_those_in_the_strongest_noise():
    noise = result("shipped/noise.json")
    (name,) = (name for name in ROWS if "asked for" in name)
    assert f"{noise['settings']['speed']} m/s asked for" in name
    speeds = {
        run["mode"]: f"{run['mean_forward_velocity']:.2f} m/s"
        for run in noise["runs"]
        if (run["fault"], run["severity"]) == ("gaussian", 5)
    }
    assert ROWS[name] == [speeds["camera"], "–", speeds["memory"]]


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
