"""Curves on disk."""

from __future__ import annotations

import pytest

from renet.errors import RenetError
from renet.training.metrics import CURVES, MetricsWriter, read_curves


def test_a_resumed_runs_last_value_counts(tmp_path):
    for value in (1.0, 2.0):
        writer = MetricsWriter(str(tmp_path))
        writer.add_scalar("Loss/value", value, 7)
        writer.stop()
    assert read_curves(tmp_path) == {"Loss/value": ([7], [2.0])}


def test_a_full_disk_is_named(tmp_path):
    (tmp_path / CURVES).symlink_to("/dev/full")
    writer = MetricsWriter(str(tmp_path))
    writer.add_scalar("Loss/value", 1.0, 1)
    with pytest.raises(RenetError, match=r"cannot write the curves .*No space left"):
        writer.flush()
