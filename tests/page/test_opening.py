"""The scene that opens the page, again and again: other noise, another angle at the start."""

from pathlib import Path

import pytest

from renet.page.writer import WEB
from tests.page.conftest import run_node

pytestmark = pytest.mark.wall_clock

STARTS = (2, 3, 5)
"""Openings that begin to the right, straight on and to the left."""


def openings(page: Path, robot: str, mode: str) -> dict:
    """What the page would say of them."""
    return run_node("opening.mjs", WEB, page, f"?robot={robot}", mode, *STARTS)


@pytest.mark.parametrize("robot", ["go1", "go2"])
def test_the_robot_that_switches_falls_in_each(node_page: Path, robot):
    opening = openings(node_page, robot, "switch")
    assert (opening["ground"], opening["fault"], opening["left"]) == ("gap", "gaussian", "switch")
    assert len(opening["sentences"]) == len(STARTS)
    for sentence in opening["sentences"]:
        assert sentence.startswith("Switch fell")
        assert sentence.endswith("s after its camera broke.")


@pytest.mark.parametrize("robot", ["go1", "go2"])
def test_the_robot_that_remembers_crosses_in_each(node_page: Path, robot):
    sentences = openings(node_page, robot, "memory")["sentences"]
    assert sentences == ["Memory leapt the gap from memory."] * len(STARTS)
