"""Bundles on the Hugging Face Hub, `hf://owner/name` in place of a folder."""

import os
import re
from pathlib import Path
from typing import Any

from renet.bundle.contents import SHARED
from renet.errors import RenetError, install

PREFIX = re.compile(r"hf:/{1,2}")
"""Pattern that begins names on the Hub; a `Path` of such a name has a single slash."""
REPOSITORY = r"[A-Za-z0-9][\w.-]*/[A-Za-z0-9][\w.-]*"
"""Pattern of a repository: owner and name."""
NEWEST = "main"
"""Revision that is loaded where none is named."""


def is_remote(name: Path | str) -> bool:
    """Return True if a bundle's name is one on the Hub."""
    return PREFIX.match(str(name)) is not None


def fetch(name: Path | str) -> Path:
    """Load a bundle from the Hub, and return its folder on this computer.

    Without a connection, the files that were loaded before are used.

    Args:
        name: `hf://owner/name` or `hf://owner/name@revision`.

    Raises:
        RenetError: The name is another one, there is no such repository or no connection, or
            huggingface_hub is not installed.
    """
    match = re.fullmatch(rf"{PREFIX.pattern}({REPOSITORY})(?:@([\w./-]+))?", str(name))
    if match is None or ".." in str(name):
        raise RenetError(
            f"{name} names no bundle on the Hub: write hf://owner/name or hf://owner/name@revision"
        )
    repository = match[1]
    revision = match[2] or NEWEST
    hub = library()
    folder = cache() / revision / repository
    try:
        # Into a folder of its own: the Hub's own cache holds links, which no bundle may.
        hub.snapshot_download(
            repository, revision=revision, local_dir=folder, allow_patterns=[*SHARED]
        )
    # The errors of its HTTP library have no common class.
    except Exception as error:
        raise RenetError(
            f"cannot load hf://{repository} at {revision}: {first_line(error)}; is the name right,"
            " and the network up? A private one needs `hf auth login`"
        ) from error
    return folder


def cache() -> Path:
    """Return the folder of bundles from the Hub, which may be deleted at any time."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "renet" / "hub"


def library() -> Any:
    """Import huggingface_hub; raises RenetError if it is not installed."""
    try:
        import huggingface_hub
    except ModuleNotFoundError as error:
        raise RenetError(f"bundles on the Hub need huggingface_hub: {install('hub')}") from error
    return huggingface_hub


def first_line(error: Exception) -> str:
    """Return the first line of an exception's message, or its name where it has none."""
    text = str(error).strip() or type(error).__name__
    return text.splitlines()[0].rstrip(".;: ")
