"""The script that counts lines: what it counts, and that limits only go down."""

import json

import pytest

import size


@pytest.fixture
def project(tmp_path):
    """5 lines in src, whose widest folder has 2 files of code, and 1 line in tests."""
    for name, text in {
        "src/a.py": "\n\n",
        "src/b/c.cpp": "x\n",
        "src/b/d.h": "x\ny\n",
        "src/b/page.html": "x\n" * 99,
        "tests/t.py": "x\n",
    }.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    return tmp_path


FOUND = {"src_lines": 5, "tests_lines": 1, "widest_folder": 2}


def test_code_is_counted_and_nothing_else(project):
    assert size.measure(project) == FOUND


@pytest.mark.parametrize("name", FOUND)
def test_one_above_its_limit_fails(project, capsys, name):
    limits = project / "size.json"
    limits.write_text(json.dumps(FOUND))
    assert size.main([], project, limits) == 0
    limits.write_text(json.dumps({**FOUND, name: FOUND[name] - 1}))
    assert size.main([], project, limits) == 1
    assert f"{name}: {FOUND[name]} of {FOUND[name] - 1} TOO MANY" in capsys.readouterr().out


def test_limits_only_go_down(project):
    limits = project / "size.json"
    limits.write_text(json.dumps({"src_lines": 9, "tests_lines": 0, "widest_folder": 2}))
    assert size.main(["--lower"], project, limits) == 1
    lowered = {"src_lines": 5, "tests_lines": 0, "widest_folder": 2}
    assert json.loads(limits.read_text()) == lowered
