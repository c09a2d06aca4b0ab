import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from ..forked import Fork, forks
from .files import FILES


@pytest.fixture(scope="session")
def hostile(tmp_path_factory, worker_id) -> Path:
    """A folder of hostile files beside a victim, and their paths by name."""
    folder = tmp_path_factory.mktemp("hostile")
    (folder / "files" / "victim").mkdir(parents=True)
    base = tmp_path_factory.getbasetemp()
    # The folder of a worker is one of the whole run's.
    verdicts = (base if worker_id == "master" else base.parent) / "verdicts"
    verdicts.mkdir(exist_ok=True)
    (folder / "verdicts").symlink_to(verdicts)
    (folder / "files" / "victim" / "thesis.tex").write_text("years of work")
    paths = {}
    for number, (title, make) in enumerate(FILES.items()):
        (place := folder / "files" / str(number)).mkdir()
        paths[title] = str(make(place) or place)
    (folder / "paths.json").write_text(json.dumps(paths))
    return folder


@pytest.fixture(scope="session")
def fork() -> Iterator[Fork]:
    """Calls functions in processes that begin with all commands imported."""
    with forks() as fork:
        yield fork
