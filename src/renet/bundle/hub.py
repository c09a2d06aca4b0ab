"""Bundles on the Hugging Face Hub, `hf://owner/name` in place of a folder."""

import os
import re
from pathlib import Path
from typing import Any

from renet.bundle.contents import SHARED
from renet.errors import RenetError, install

PREFIX = re.compile(r"hf:/{1,2}")
"""Of a name on the Hub; a Path of it has a single slash."""
NAME = r"[A-Za-z0-9][\w.-]*/[A-Za-z0-9][\w.-]*"
"""Owner and name."""
NEWEST = "main"
"""The revision that is loaded where none is named."""


def is_remote(name: Path | str) -> bool:
    """Whether a bundle's name is one on the Hub."""
    return PREFIX.match(str(name)) is not None


def fetch(name: Path | str) -> Path:
    """The folder on this computer with the newest files of a bundle on the Hub.

    Without a connection, those that were loaded before.

    Args:
        name: hf://owner/name or hf://owner/name@revision.

    Raises:
        RenetError: another name, no such repository, no connection, or no huggingface_hub here.
    """
    match = re.fullmatch(rf"{PREFIX.pattern}({NAME})(?:@([\w./-]+))?", str(name))
    if match is None or ".." in str(name):
        raise RenetError(
            f"{name} names no bundle on the Hub: write hf://owner/name or hf://owner/name@revision"
        )
    repository, revision = match[1], match[2] or NEWEST
    hub = library()
    folder = cache() / revision / repository
    try:
        # Into a folder of its own: the Hub's own cache holds links, which no bundle may.
        hub.snapshot_download(
            repository, revision=revision, local_dir=folder, allow_patterns=[*SHARED]
        )
    # Whatever its HTTP library raises.
    except Exception as error:
        raise RenetError(
            f"cannot load hf://{repository} at {revision}: {first_line(error)}; is the name right,"
            " and the network up? A private one needs `hf auth login`"
        ) from error
    return folder


def cache() -> Path:
    """The folder for bundles from the Hub, which may be deleted at any time."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "renet" / "hub"


def library() -> Any:
    """huggingface_hub; raises RenetError where it is not installed."""
    try:
        import huggingface_hub
    except ModuleNotFoundError as error:
        raise RenetError(f"bundles on the Hub need huggingface_hub: {install('hub')}") from error
    return huggingface_hub


def first_line(error: Exception) -> str:
    """What an exception says first, or its name."""
    text = str(error).strip() or type(error).__name__
    return text.splitlines()[0].rstrip(".;: ")
