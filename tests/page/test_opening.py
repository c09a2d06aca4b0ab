"""The scene that opens the page, again and again: other noise, another angle at the start."""

from pathlib import Path

import pytest

from renet.page.writer import WEB
from tests.page.conftest import run_node

pytestmark = pytest.mark.wall_clock

LOADS = 10


@pytest.mark.parametrize("robot", ["go1", "go2"])
def test_only_the_robot_that_remembers_crosses_in_ten_of_ten_openings(node_page: Path, robot):
    told = {}
    for mode in ("switch", "memory"):
        link = f"?robot={robot}"
        told[mode] = run_node("opening.mjs", WEB, node_page, link, mode, *range(1, LOADS + 1))
    opening = told["switch"]
    assert (opening["ground"], opening["fault"], opening["left"]) == ("gap", "gaussian", "switch")
    assert told["memory"]["sentences"] == ["Memory leapt the gap from memory."] * LOADS
    for sentence in opening["sentences"]:
        assert sentence.startswith("Switch fell")
        assert sentence.endswith("s after its camera broke.")
