import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest

from ..bundle.conftest import manifest, models, networks  # noqa: F401  fixtures here, too
from .tiny import TINY


@pytest.fixture(scope="session")
def run_study(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], tuple[Path, dict]]:
    """Runs a study of `TINY`, once; returns its folder and summary, which tests must not change."""
    root = tmp_path_factory.mktemp("results")

    def run(name: str) -> tuple[Path, dict]:
        study, evaluator = TINY[name]
        replace(study, out=root / name).run(evaluator())
        return root / name, json.loads((root / name / "summary.json").read_text())

    return cache(run)


@pytest.fixture
def summary(folder: Path) -> dict:
    """The summary of the study that a file of tests has as its `folder`."""
    return json.loads((folder / "summary.json").read_text())
