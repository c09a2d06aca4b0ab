"""The program that a film of a training is made by: the one that registered its task."""

import subprocess
import sys

import pytest

FILE = """
from renet.cli import main
from renet.program import own_program
main({argv})
print(own_program())
"""


@pytest.mark.parametrize(
    ("argv", "as_module", "program"),
    [
        ("", False, "{path}"),
        ("", True, "-m robots.mine"),
        # Its command line may mean anything to it.
        ("['--version']", False, "-m renet"),
    ],
)
def test_a_program_is_run_again_if_its_command_line_is_renets(tmp_path, argv, as_module, program):
    path = tmp_path / "robots" / "mine.py"
    path.parent.mkdir()
    path.write_text(FILE.format(argv=argv))
    how = ["-m", "robots.mine"] if as_module else [str(path)]
    command = [sys.executable, *how, "--version"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    expected = [sys.executable, *program.format(path=path).split()]
    assert done.stdout.splitlines()[-1] == str(expected)
