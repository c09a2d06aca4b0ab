"""A bundle for the Go2."""

from pathlib import Path

import pytest

from renet.bundle import write_bundle
from renet.bundle.manifest import Manifest
from renet.selector import SelectorSpec
from renet.tasks.config.go2 import GO2
from renet.training.export import camera_spec, robot_spec


@pytest.fixture
def go2_bundle(tmp_path, models) -> Path:
    """Untrained networks, exported for the Go2."""
    manifest = Manifest(robot_spec(GO2), camera_spec(GO2), SelectorSpec(beta=0.25))
    return write_bundle(tmp_path / "go2-bundle", models, manifest)
