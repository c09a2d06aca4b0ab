"""`renet bundle push`: upload of a bundle and its card to the Hugging Face Hub."""

import re
from dataclasses import dataclass
from pathlib import Path

import tyro

from renet.bundle import Bundle
from renet.bundle.card import card
from renet.bundle.contents import CARD_FILE, SHARED
from renet.bundle.hub import REPOSITORY, first_line, library
from renet.errors import RenetError


@dataclass(frozen=True)
class PushCfg:
    """Put a bundle on the Hugging Face Hub, into a repository of models that is made if need be."""

    bundle: tyro.conf.Positional[Path]
    """Bundle folder, or the name of one that ships."""
    repository: tyro.conf.Positional[str]
    """owner/name on the Hub."""
    private: bool = False
    """Make a new repository a private one."""
    revision: str | None = None
    """Branch to push to; by default the main one."""
    message: str | None = None
    """Message of the commit."""


def push(cfg: PushCfg) -> str:
    """Verify a bundle and upload its files and its model card.

    The card is the folder's README.md. Without one, a card without results is written from the
    bundle, as `renet bundle card` does.

    Returns:
        A sentence with the bundle's name on the Hub, for the user.

    Raises:
        RenetError: The bundle cannot be used, the name is none of a repository, or the Hub refuses.
    """
    if not re.fullmatch(REPOSITORY, cfg.repository) or ".." in cfg.repository:
        raise RenetError(f"{cfg.repository!r} names no repository on the Hub: write owner/name")
    bundle = Bundle.load(cfg.bundle)
    hub = library()
    present = [name for name in SHARED if (bundle.path / name).is_file()]
    message = cfg.message or f"Bundle {bundle.name} {bundle.sha256[:12]}"
    operations = [hub.CommitOperationAdd(name, str(bundle.path / name)) for name in present]
    if CARD_FILE not in present:
        text = card(bundle, [], "apache-2.0").encode()
        operations.append(hub.CommitOperationAdd(CARD_FILE, text))
    api = hub.HfApi()
    # One commit holds all files, so that nobody loads half a bundle.
    try:
        api.create_repo(cfg.repository, private=cfg.private or None, exist_ok=True)
        api.create_commit(cfg.repository, operations, commit_message=message, revision=cfg.revision)
    except Exception as error:
        raise RenetError(
            f"cannot push to {cfg.repository}: {first_line(error)}; `hf auth login` with a token"
            " that may write, and a repository of your own, are needed"
        ) from error
    at = f"@{cfg.revision}" if cfg.revision else ""
    return f"Pushed {bundle.name}: renet deploy hf://{cfg.repository}{at} runs it"
