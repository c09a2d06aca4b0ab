"""One small environment per task, shared by all tests of a module."""

from __future__ import annotations

from contextlib import redirect_stdout
from io import StringIO

import pytest

from renet.tasks import RenetEnv, make_env


def build(*args, **kwargs) -> RenetEnv:
    with redirect_stdout(StringIO()):
        return make_env(*args, **kwargs)


@pytest.fixture(scope="module")
def flat() -> RenetEnv:
    env = build("Renet-Go1-Flat", 4)
    env.reset()
    return env


@pytest.fixture(scope="module")
def parkour() -> RenetEnv:
    env = build("Renet-Go1-Parkour", 12)
    env.reset()
    return env
