"""Version of the running code, for checkpoints and results."""

from __future__ import annotations

import subprocess
from pathlib import Path

from renet import __version__

CHECKOUT = Path(__file__).parents[2]
"""Root of the clone, if renet runs from one."""


def commit() -> str | None:
    """Return the clone's commit, 12 digits, `+changed` if files differ; None without a clone."""
    git = ["git", "-C", str(CHECKOUT), "describe", "--always", "--dirty=+changed", "--abbrev=12"]
    # A repository around an installed package is another project's.
    if not (CHECKOUT / ".git").exists():
        return None
    try:
        result = subprocess.run(git, capture_output=True, text=True, timeout=5, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    return result.stdout.strip()


def code_version() -> str:
    """Return the version, with the commit if there is one, such as "0.2.0 (1f2e3d4c5b6a)"."""
    revision = commit()
    return f"{__version__} ({revision})" if revision else __version__
