"""Simulated robots behind real links, and a bundle for each."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from ...bundle.conftest import go2_bundle  # noqa: F401
from .peer import KINDS, Peer, Wire, make_peer


def pytest_generate_tests(metafunc):
    """A test of a robot runs with each kind; one in a kind's folder with that alone."""
    if "robot_kind" in metafunc.fixturenames:
        folder = metafunc.definition.path.parent.name
        metafunc.parametrize("robot_kind", [folder] if folder in KINDS else list(KINDS))


@pytest.fixture
def peer(robot_kind) -> Iterator[Peer]:
    with make_peer(robot_kind) as peer:
        yield peer


@pytest.fixture
def wire(peer) -> Wire:
    """Link and robot in lockstep, before the first exchange."""
    return peer.wire()


@pytest.fixture
def free(wire) -> Wire:
    """The wire of a robot that lies and may be commanded."""
    wire.start()
    return wire


@pytest.fixture
def served(peer) -> Iterator[Peer]:
    """A robot that lives beside the test."""
    with peer.serving():
        yield peer


@pytest.fixture
def kinds_bundle(robot_kind, bundle_path, go2_bundle) -> Path:  # noqa: F811
    """Untrained networks for the robot."""
    return {"go1": bundle_path, "go2": go2_bundle}[robot_kind]
