"""`renet average`: the mean of a run's last checkpoints.

Each gradient step leaves its own noise in the weights. Their mean along a run has less of it
(Izmailov et al. 2018, arXiv 1803.05407) and often walks better than any checkpoint it is made of.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import torch
import tyro
from torch import Tensor

from renet.errors import RenetError
from renet.training import checkpoint as checkpoints
from renet.training.checkpoint import Checkpoint


@dataclass(kw_only=True)
class AverageCfg:
    """Make one checkpoint of several: the mean of their weights. All else is the newest's."""

    run: tyro.conf.Positional[Path]
    """Run folder, or a folder of checkpoints."""
    last: int | None = None
    """How many of its newest checkpoints to take; None: all. `renet train` keeps as many as
    --keep-checkpoints says."""
    out: Path = Path("average")
    """Folder for the new checkpoint, which `renet export` and `renet train --resume` take."""


def average(cfg: AverageCfg) -> Path:
    """Write the mean and return its folder; raises RenetError for checkpoints that do not fit."""
    inside = cfg.run / "checkpoints"
    found = checkpoints.checkpoints(inside if inside.is_dir() else cfg.run)
    last = len(found) if cfg.last is None else cfg.last
    if not 2 <= last <= len(found):
        raise RenetError(
            f"cannot average {last} checkpoints: {cfg.run} has {len(found)}, and it takes two"
        )
    if checkpoints.checkpoints(cfg.out):
        raise RenetError(f"{cfg.out} holds a checkpoint already: choose another --out")
    paths = found[-last:]
    loaded = [checkpoints.load(path) for path in paths]
    newest = loaded[-1]
    for path, other in zip(paths, loaded, strict=True):
        checkpoints.check_same_architecture(newest.model, other.model, path)
    model = {name: _mean([each.model[name] for each in loaded]) for name in newest.model}
    mean = Checkpoint(model, {}, newest.environment, newest.state)
    return checkpoints.save(mean, cfg.out, newest.state["iteration"], keep=1)


def _mean(tensors: list[Tensor]) -> Tensor:
    """Element by element; counts are the newest's."""
    if not tensors[-1].is_floating_point():
        return tensors[-1]
    return torch.stack(tensors).mean(0)
