import json
from dataclasses import replace
from functools import cache

import pytest

from ..bundle.conftest import manifest, models, networks  # noqa: F401  fixtures here, too
from .fakes import FakeEvaluator
from .tiny import EVALUATORS, TINY


@pytest.fixture(scope="session")
def run_study(tmp_path_factory):
    """Runs a study of `TINY`, once; returns its folder and summary, which tests must not change."""
    root = tmp_path_factory.mktemp("results")

    def run(name: str):
        replace(TINY[name], out=root / name).run(EVALUATORS.get(name, FakeEvaluator)())
        return root / name, json.loads((root / name / "summary.json").read_text())

    return cache(run)
