"""The page with the policy that can be driven: its robot goes where it is told."""

from pathlib import Path

import pytest

from renet.page.writer import WEB
from tests.page.conftest import run_node

pytestmark = pytest.mark.wall_clock

COMMANDS = {
    "ahead": (0.6, 0.0, 0.0),
    "back": (-0.6, 0.0, 0.0),
    "left": (0.0, 0.5, 0.0),
    "right": (0.0, -0.5, 0.0),
    "turn": (0.0, 0.0, 0.8),
}
"""Velocities ahead and to the left, m/s, and turn rates, rad/s."""


def test_it_walks_back_and_sideways_and_turns(node_page: Path):
    asked = [",".join(map(str, velocity)) for velocity in COMMANDS.values()]
    link = "?robot=go1&bundle=go1-driven&ground=flat&fault=none"
    walks = run_node("drive.mjs", WEB, node_page, link, "camera", *asked)
    for (way, velocity), walk in zip(COMMANDS.items(), walks, strict=True):
        assert not walk["fell"], way
        walked = (walk["forward"], walk["left"], walk["turnRate"])
        for component, wished in zip(walked, velocity, strict=True):
            assert component == pytest.approx(wished, abs=0.2), way
