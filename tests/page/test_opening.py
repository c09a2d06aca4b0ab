"""The scene that opens the page, again and again: other noise, another angle at the start."""

from pathlib import Path

from renet.page.writer import WEB
from tests.page.conftest import run_node

LOADS = 10


def test_renet_leaps_the_gap_from_memory_in_ten_of_ten_loads(node_page: Path):
    opening = run_node("opening.mjs", WEB, node_page, "memory", *range(1, LOADS + 1))
    assert (opening["ground"], opening["fault"], opening["left"]) == ("gap", "blackout", "forgets")
    assert opening["sentences"] == ["Memory leapt the gap from memory."] * LOADS


def test_the_same_robot_without_memory_is_blind_at_the_gap(node_page: Path):
    opening = run_node("opening.mjs", WEB, node_page, "forgets", 1, 2)
    for sentence in opening["sentences"]:
        assert "s after its camera broke" in sentence or sentence.endswith("the gap blind.")
