import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest

from ..bundle.conftest import manifest, models, networks  # noqa: F401  fixtures here, too
from .fakes import FakeEvaluator
from .tiny import EVALUATORS, TINY


@pytest.fixture(scope="session")
def run_study(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], tuple[Path, dict]]:
    """Runs a study of `TINY`, once; returns its folder and summary, which tests must not change."""
    root = tmp_path_factory.mktemp("results")

    def run(name: str) -> tuple[Path, dict]:
        replace(TINY[name], out=root / name).run(EVALUATORS.get(name, FakeEvaluator)())
        return root / name, json.loads((root / name / "summary.json").read_text())

    return cache(run)
