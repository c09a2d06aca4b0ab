"""The tests' bundles, controllers that are fed with them, and a terminal."""

import os
import pty
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from renet.deploy.cfg import DeployCfg
from renet.deploy.main import RECORDING, deploy

from ..bundle.conftest import bundle, bundle_path, manifest, models, networks  # noqa: F401
from .fakes import Run


@pytest.fixture
def run(bundle) -> Run:  # noqa: F811
    """A controller that is fed by hand, before its first step."""
    return Run(bundle)


@pytest.fixture
def walk(run) -> Run:
    """The same, once its robot walks and sees."""
    run.ticks(60)
    return run


@pytest.fixture(scope="session")
def log(tmp_path_factory) -> Path:
    """Six simulated seconds on the plane with the shipped bundle, of which four are walked."""
    return deploy(DeployCfg(seconds=6.0, out=tmp_path_factory.mktemp("log"))) / RECORDING


@pytest.fixture
def terminal(monkeypatch) -> Iterator[int]:
    """What is written here are keys pressed on the program's terminal."""
    master, slave = pty.openpty()
    with os.fdopen(slave) as stream:
        monkeypatch.setattr(sys, "stdin", stream)
        yield master
