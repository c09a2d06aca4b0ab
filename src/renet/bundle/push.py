"""`renet bundle push`: a bundle and its card to the Hugging Face Hub."""

import re
from dataclasses import dataclass
from pathlib import Path

import tyro

from renet.bundle import Bundle
from renet.bundle.card import card
from renet.bundle.contents import CARD, SHARED
from renet.bundle.hub import NAME, first_line, library
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
    """Verify a bundle and upload its files, and its model card; returns a sentence with its name.

    The card is the folder's README.md; without one, it is written from the bundle (`bundle card`),
    without results.

    Raises:
        RenetError: a bundle that cannot be used, a name that is none, or a refusal of the Hub's.
    """
    if not re.fullmatch(NAME, cfg.repository) or ".." in cfg.repository:
        raise RenetError(f"{cfg.repository!r} names no repository on the Hub: write owner/name")
    bundle = Bundle.load(cfg.bundle)
    hub = library()
    present = [name for name in SHARED if (bundle.path / name).is_file()]
    message = cfg.message or f"Bundle {bundle.name} {bundle.sha256[:12]}"
    operations = [hub.CommitOperationAdd(name, str(bundle.path / name)) for name in present]
    if CARD not in present:
        text = card(bundle, [], "apache-2.0").encode()
        operations.append(hub.CommitOperationAdd(CARD, text))
    api = hub.HfApi()
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
