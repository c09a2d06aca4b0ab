"""Hostile files, each handed to every option of every command that takes a path.

Whatever it is, a command reads it or says in one line what is wrong with it: without a traceback,
without waiting or taking much memory, and without touching a file of the user's. The studies have a
file of their own, so that another worker may run them.
"""

import pytest

from renet.cli import COMMANDS, main
from renet.terminal import Terminal, show

from .files import FILES, manifest
from .paths import OPTIONS, demand_no_harm

OTHERS = [option for option in OPTIONS if not option[0].startswith("evaluate")]


@pytest.mark.parametrize(("name", "option", "variant"), OTHERS, ids=str)
def test_no_command_is_hurt_by_a_hostile_file(hostile, fork, name, option, variant):
    demand_no_harm(hostile, fork, name, option, variant)


def test_there_are_sixty_files_and_every_command_that_reads_is_tried():
    assert len(FILES) >= 60
    reading = {name for name, _, _ in OPTIONS}
    assert set(COMMANDS) - reading == {"simulate"}, "this one reads nothing"
    brief = ("--seconds", "0.1")
    assert {("deploy", "--scene", brief), ("deploy", "bundle", brief)} <= {*OPTIONS}
    assert ("deploy", "--recording", ("--camera", "replay", *brief)) in OPTIONS


def test_no_strangers_text_commands_the_terminal(capsys):
    """Whether as an error, in a table or as an event of a run."""
    title = "a\x1b]0;owned\x07\nb\x9bc"
    assert main(["evaluate", title]) == 2
    show(title, ["of"], [[title]])
    terminal = Terminal()
    terminal.say(title)
    terminal.close()
    said = "".join(capsys.readouterr())
    assert said.count("owned") >= 4
    assert all(c.isprintable() or c == "\n" for c in said)
    assert "a\nb" not in said


def test_markup_in_a_bundle_is_printed_as_it_is(tmp_path, capsys):
    markup = "[bold red]x[/]"
    path = manifest(provenance={"task": markup}, robot={"name": markup})(tmp_path)
    assert main(["bundle", "inspect", str(path)]) == 0
    assert capsys.readouterr().out.count(markup) == 2, "in a line and over a table"
