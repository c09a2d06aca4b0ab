"""Nothing of a compiler's or a library's chatter reaches who starts a training."""

from __future__ import annotations

import subprocess
import sys

import pytest

STEP = """
import sys
{first}
from renet.tasks import make_env
env = make_env("Renet-Go1-Parkour", 2)
env.reset()
env.step(env.action_manager.action)
"""


@pytest.mark.parametrize("first", ["import renet.sim", "import mjlab", "import torch, warp"])
def test_warp_says_nothing_whoever_is_imported_first(first):
    """Neither that it starts or has no GPU, nor which modules it compiles and loads."""
    code = STEP.format(first=first)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    for said in (done.stdout, done.stderr):
        assert "Warp" not in said
        assert "load on device" not in said
        assert "CUDA" not in said
