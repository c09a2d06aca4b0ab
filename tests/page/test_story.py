"""Sentences of the page about robots that neither fall nor cross."""

import shutil

import pytest

from renet.page.writer import WEB
from tests.page.conftest import run_node


@pytest.mark.skipif(shutil.which("node") is None, reason="no Node.js on this machine")
@pytest.mark.parametrize(
    ("walks", "stands", "sentence"),
    [(10, 0, "Memory walks on after 5.0 m."), (4, 6, "Memory stands after 2.0 m.")],
)
def test_a_robot_that_stands_does_not_walk_on(walks, stands, sentence):
    assert run_node("story.mjs", WEB, walks, stands) == sentence
