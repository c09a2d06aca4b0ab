"""The scene that opens the page, again and again: other noise, another angle at the start."""

from pathlib import Path

import pytest

from renet.page.writer import WEB
from tests.page.conftest import run_node

pytestmark = pytest.mark.wall_clock

LOADS = 10


def openings(page: Path, robot: str, mode: str) -> dict:
    """What the page would say of them."""
    return run_node("opening.mjs", WEB, page, f"?robot={robot}", mode, *range(1, LOADS + 1))


@pytest.mark.parametrize("robot", ["go1", "go2"])
def test_the_robot_that_switches_falls_in_ten_of_ten_openings(node_page: Path, robot):
    opening = openings(node_page, robot, "switch")
    assert (opening["ground"], opening["fault"], opening["left"]) == ("gap", "gaussian", "switch")
    assert len(opening["sentences"]) == LOADS
    for sentence in opening["sentences"]:
        assert sentence.startswith("Switch fell")
        assert sentence.endswith("s after its camera broke.")


@pytest.mark.parametrize("robot", ["go1", "go2"])
def test_the_robot_that_remembers_crosses_in_ten_of_ten_openings(node_page: Path, robot):
    sentences = openings(node_page, robot, "memory")["sentences"]
    assert sentences == ["Memory leapt the gap from memory."] * LOADS
