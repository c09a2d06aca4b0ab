"""Pages that name files and tests: each of them exists."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


def named(page: str) -> set[tuple[str, str]]:
    """Files in backquotes and what follows `::`; an ellipsis stands for the file before."""
    text, pairs, file = (ROOT / "docs" / page).read_text(), set(), ""
    for path, name in re.findall(r"`(…|[a-z0-9_/]+\.py)(?:::([a-z0-9_]+))?`", text):
        file = file if path == "…" else path
        pairs.add((file, name))
    return pairs


def test_every_file_the_method_page_names_exists():
    sources = {file for file, name in named("method.md") if not name}
    assert len(sources) > 25
    assert not [file for file in sources if not (ROOT / "src" / "renet" / file).is_file()]


@pytest.mark.parametrize(("page", "least"), [("method.md", 40), ("security.md", 35)])
def test_every_test_a_page_names_exists(page: str, least: int):
    tests = {(file, name) for file, name in named(page) if "test_" in file}
    assert len(tests) > least
    for file, name in tests:
        tree = ast.parse((ROOT / "tests" / file).read_text())
        defined = {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}
        assert not name or name in defined, f"{file} has no {name}"
