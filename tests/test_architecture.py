"""docs/architecture.md: three walks of five files at most that exist, and the true layers."""

import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "architecture.md").read_text()
WALKS = [section for section in PAGE.split("\n## ")[1:] if "\n1. " in section]


@pytest.mark.parametrize("walk", WALKS, ids=lambda walk: walk.splitlines()[0])
def test_a_walk_has_at_most_five_files_and_each_exists(walk):
    steps = re.findall(r"^\d\. `([^`]+)`", walk, re.MULTILINE)
    assert 3 <= len(steps) <= 5
    assert len(steps) == len(re.findall(r"^\d\.", walk, re.MULTILINE))
    missing = [step for step in steps if not (ROOT / step).is_file()]
    assert not missing
    assert len(WALKS) == 3


def test_the_layers_are_those_that_ci_checks():
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    layers = contracts["contracts"][0]["layers"]
    section = PAGE.split("## Packages")[1].split("\n## ")[0]
    rows = re.findall(r"^\| (`.*?) \|", section, re.MULTILINE)
    names = [re.findall(r"`(\w+)`", row) for row in rows]
    assert names == [re.findall(r"renet\.(\w+)", layer) for layer in layers]
    packages = {path.parent.name for path in (ROOT / "src" / "renet").glob("*/__init__.py")}
    assert packages <= {name for row in names for name in row}
