"""mjlab finds the tasks by itself."""

from __future__ import annotations

import subprocess
import sys

import pytest


@pytest.mark.parametrize(
    "first", ["mjlab.tasks", "renet.sim.depth.camera", "renet.training.config", "renet.tasks"]
)
def test_tasks_are_registered_whatever_is_imported_first(first):
    code = (
        f"import {first}, mjlab.tasks; from mjlab.tasks.registry import list_tasks;"
        "print([t for t in list_tasks() if t.startswith('Renet')])"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert "['Renet-Go1-Flat', 'Renet-Go1-Parkour']" in result.stdout
    assert "Failed to load" not in result.stdout + result.stderr
