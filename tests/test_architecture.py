"""docs/architecture.md: three walks of five files at most that exist, and a true picture."""

import re
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


def imports(package: str) -> set[str]:
    """Packages of renet that the files of one import, directly."""
    root = ROOT / "src" / "renet"
    files = [*(root / package).rglob("*.py"), *root.glob(f"{package}.py")]
    text = "\n".join(file.read_text() for file in files)
    return set(re.findall(r"^\s*from renet\.(\w+)", text, re.MULTILINE))


def test_every_package_is_in_the_picture_and_every_arrow_is_an_import():
    root = ROOT / "src" / "renet"
    packages = {path.parent.name for path in root.glob("*/__init__.py")}
    names = set(re.findall(r"^\s+.*?(\w+)\[\"", PAGE, re.MULTILINE))
    assert packages <= names
    arrows = re.findall(r"^\s+(\w+)(?:\[\"[^\"]*\"\])? --> ([\w &]+)$", PAGE, re.MULTILINE)
    pairs = [(a, b) for a, targets in arrows for b in targets.split(" & ") if a != "cli"]
    assert len(pairs) > 12
    wrong = [(a, b) for a, b in pairs if b not in imports(a)]
    assert not wrong
