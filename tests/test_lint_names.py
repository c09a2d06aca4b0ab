"""tools/lint_names.py refuses participles as names and docstrings that begin with "Of"."""

import pytest

import lint_names


@pytest.mark.parametrize(
    "source",
    [
        "found = 1",
        "for own in (): ...",
        "[known for known in ()]",
        "def f(asked): ...",
        "f = lambda *, wanted: 0",
        "self._told = 1",
        "with open('x') as found: ...",
        "class A:\n    own: int = 0",
        "try: ...\nexcept OSError as told: ...",
        "match x:\n    case [known]: ...",
        "if (found := x): ...",
        'def f():\n    """Of a robot: its speed."""',
        'SPEED = 1\n"""Of the robot, m/s."""',
    ],
)
def test_what_is_no_noun_is_refused_with_its_line(source, tmp_path, capsys):
    (tmp_path / "module.py").write_text(f"import os\n\n{source}\n")
    assert lint_names.main([str(tmp_path)]) == 1
    assert capsys.readouterr().out.count("module.py:") == 1


def test_nouns_others_attributes_and_other_docstrings_pass(tmp_path, capsys):
    source = '"""Offset of a foot."""\nresult, founder = data.found, {"own": 1}\nf(found=1)\n'
    (tmp_path / "module.py").write_text(source)
    assert lint_names.main([str(tmp_path)]) == 0
