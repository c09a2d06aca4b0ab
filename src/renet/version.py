"""Which code runs: provenance of checkpoints and results."""

from __future__ import annotations

import subprocess
from pathlib import Path

from renet import __version__

CHECKOUT = Path(__file__).parents[2]
"""Where git knows the code, if renet runs from a clone."""


def commit() -> str | None:
    """The clone's commit, 12 digits, `+changed` if edited; None where renet is not in a clone."""
    git = ["git", "-C", str(CHECKOUT), "describe", "--always", "--dirty=+changed", "--abbrev=12"]
    if not (CHECKOUT / ".git").exists():
        return None  # An installed package: a repository around it is another project's.
    try:
        found = subprocess.run(git, capture_output=True, text=True, timeout=5, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    return found.stdout.strip()


def code_version() -> str:
    """Version of renet, with the commit if there is one, such as "0.1.0 (1f2e3d4c5b6a)"."""
    found = commit()
    return f"{__version__} ({found})" if found else __version__
