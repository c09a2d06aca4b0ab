"""The tests' bundles, and calibration from short recordings."""

import pytest

from renet.deploy.recording import calibration_log

from ..bundle.conftest import bundle, bundle_path, manifest, models, networks  # noqa: F401


@pytest.fixture
def short_logs_will_do(monkeypatch):
    """Calibration from seconds instead of minutes."""
    monkeypatch.setattr(calibration_log, "MIN_MINUTES", 0.0)
