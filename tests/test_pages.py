"""Pages that name files and tests: each of them exists."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
METHOD = (ROOT / "docs" / "method.md").read_text()


def test_every_file_the_method_page_names_exists():
    named = re.findall(r"`([a-z0-9_/]+\.py)`", METHOD)
    assert len(set(named)) > 25
    missing = [name for name in named if not (ROOT / "src" / "renet" / name).is_file()]
    assert not missing


def test_every_test_the_method_page_names_exists():
    named = re.findall(r"`([a-z0-9_/]+\.py)::([a-z0-9_]+)`", METHOD)
    assert len(set(named)) > 40
    for file, test in set(named):
        tree = ast.parse((ROOT / "tests" / file).read_text())
        defined = {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}
        assert test in defined, f"{file} has no {test}"
