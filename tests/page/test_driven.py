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


@pytest.fixture(scope="module")
def walks(node_page: Path) -> dict[str, dict]:
    """How it walked, by command."""
    asked = [",".join(map(str, velocity)) for velocity in COMMANDS.values()]
    link = "?robot=go1&bundle=go1-driven&ground=flat&fault=none"
    walks = run_node("drive.mjs", WEB, node_page, link, "camera", *asked)
    return dict(zip(COMMANDS, walks, strict=True))


@pytest.mark.parametrize("way", COMMANDS)
def test_it_walks_back_and_sideways_and_turns(walks, way):
    assert not walks[way]["fell"]
    walked = [walks[way][component] for component in ("forward", "left", "turnRate")]
    assert walked == pytest.approx(COMMANDS[way], abs=0.2)
