"""What a checkpoint says of its making: settings, the task's rules, the version of the code.

`renet recipe` prints it.
"""

from __future__ import annotations

import json
import subprocess
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any, Literal

import tyro

from renet import __version__
from renet.errors import RenetError
from renet.training import checkpoint as checkpoints


def described(value: Any) -> Any:
    """A configuration as JSON: dataclasses as dictionaries, functions and types by their names.

    Args:
        value: nested dataclasses, dictionaries, sequences, numbers and callables.
    """
    if is_dataclass(value) and not isinstance(value, type):
        return {f.name: described(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, dict):
        return {str(key): described(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set):
        return [described(item) for item in value]
    if value is None or isinstance(value, str | int | float | bool):
        return value
    if callable(value):
        return f"{value.__module__}.{getattr(value, '__qualname__', type(value).__name__)}"
    return str(value)


def code_version() -> str:
    """Version of renet, with the commit where it runs from a checkout, `+changed` if edited."""
    folder = Path(__file__).parent
    try:
        git = ["git", "-C", str(folder), "describe", "--always", "--dirty=+changed", "--abbrev=12"]
        found = subprocess.run(git, capture_output=True, text=True, timeout=5, check=True)
    except (OSError, subprocess.SubprocessError):
        return __version__
    return f"{__version__} ({found.stdout.strip()})"


@dataclass(kw_only=True)
class RecipeCfg:
    """Print how a checkpoint was trained, or how `renet train` would begin now, as JSON."""

    checkpoint: tyro.conf.Positional[Path | None] = None
    """Checkpoint, or a run folder whose newest checkpoint is taken; by default, the recipe of a run
    that would begin now."""
    task: str = "Renet-Go1-Parkour"
    """Task of the run that would begin now."""
    preset: Literal["renet", "paper"] = "renet"
    """Preset of the run that would begin now."""


def show(cfg: RecipeCfg) -> None:
    """Print settings, the task's rules and the code's version; raises RenetError without any."""
    if cfg.checkpoint is None:
        from renet.training.train import TrainCfg, settings, task_cfg

        train = TrainCfg.defaults([cfg.task, "--preset", cfg.preset])
        recipe = {"config": settings(train), "task_cfg": described(task_cfg(train))}
        print(json.dumps(recipe | {"code": code_version()}, indent=1))
        return
    if not cfg.checkpoint.exists():
        raise RenetError(f"no checkpoint at {cfg.checkpoint}")
    found = checkpoints.find(cfg.checkpoint)
    print(json.dumps(checkpoints.load_state(found) | {"numpy_rng": "not shown"}, indent=1))
