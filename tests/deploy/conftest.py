"""The tests' bundles, and calibration from short recordings."""

import os
import pty
import sys
from collections.abc import Iterator

import pytest

from renet.deploy.recording import calibration_log

from ..bundle.conftest import bundle, bundle_path, manifest, models, networks  # noqa: F401


@pytest.fixture
def terminal(monkeypatch) -> Iterator[int]:
    """What is written here are keys pressed on the program's terminal."""
    master, slave = pty.openpty()
    with os.fdopen(slave) as stream:
        monkeypatch.setattr(sys, "stdin", stream)
        yield master


@pytest.fixture
def short_logs_will_do(monkeypatch):
    """Calibration from seconds instead of minutes."""
    monkeypatch.setattr(calibration_log, "MIN_MINUTES", 0.0)
