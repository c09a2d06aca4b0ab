"""`renet recipe`: how a checkpoint was trained, or a run that would begin now."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro

from renet.errors import RenetError
from renet.training import checkpoint as checkpoints
from renet.training.checkpoint import described
from renet.training.train import TrainCfg, settings, task_cfg
from renet.version import code_version


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
        train = TrainCfg.defaults([cfg.task, "--preset", cfg.preset])
        recipe = {"config": settings(train), "task_cfg": described(task_cfg(train))}
        print(json.dumps(recipe | {"code": code_version()}, indent=1))
        return
    if not cfg.checkpoint.exists():
        raise RenetError(f"no checkpoint at {cfg.checkpoint}")
    found = checkpoints.find(cfg.checkpoint)
    print(json.dumps(checkpoints.load_state(found) | {"numpy_rng": "not shown"}, indent=1))
