"""Checkpoints: safetensors and JSON, so that loading a file never runs code in it.

A checkpoint is a folder `it_00001234` with `model.safetensors`, `average.safetensors` (the mean of
the last weights, which is exported), `optimizer.safetensors`, `environment.safetensors` and
`state.json`. It is written whole, so that a killed process or a full disk leaves earlier
checkpoints as they are.
"""

import json
import re
import sys
from copy import deepcopy
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file
from safetensors.torch import save as to_bytes
from torch import Tensor, nn
from torch.optim import Optimizer

from renet.errors import RenetError
from renet.files import MEGABYTE, read_object, require_regular
from renet.folders import foreign, remove_folder, write_folder
from renet.models.config import ModelCfg
from renet.training.provenance import described

FORMAT = 2
TENSORS = ("model", "average", "optimizer", "environment")
FILES = ("state.json", *(f"{name}.safetensors" for name in TENSORS))
"""All that a checkpoint's folder holds."""
STATE = {"iteration": int, "steps": int, "seconds": int | float, "task": str}
"""What every `state.json` holds beside its format and its settings."""
MAX_TENSORS = 100 * MEGABYTE
"""Bytes of one file of tensors; those of the default networks have at most 16 MB."""


@dataclass
class Checkpoint:
    """Everything a run needs to go on as if it had not stopped."""

    model: dict[str, Tensor]
    optimizer: dict[str, Tensor]
    """Empty in a checkpoint of weights alone: training then goes on with fresh moments."""
    environment: dict[str, Tensor]
    """Curriculum levels, command stage, and random-number state."""
    state: dict[str, Any] = field(default_factory=dict)
    """Iteration, steps, adaptive learning rate, penalties, and both configurations."""
    average: dict[str, Tensor] = field(default_factory=dict)
    """Mean of the last weights; empty in a checkpoint that has none."""

    @property
    def exported(self) -> dict[str, Tensor]:
        """The weights to judge and to export: the average where there is one."""
        return self.average or self.model


def save(checkpoint: Checkpoint, folder: Path, iteration: int, keep: int) -> Path:
    """Write atomically and keep it and the `keep` - 1 farthest others; raises RenetError."""
    final = folder / f"it_{iteration:08d}"
    state = {"format": FORMAT, "iteration": iteration, **checkpoint.state}
    contents = {"state.json": (json.dumps(state, indent=1) + "\n").encode()}
    for name in TENSORS:
        tensors = getattr(checkpoint, name).items()
        tensors = {k: v.detach().cpu().contiguous() for k, v in tensors}
        contents[f"{name}.safetensors"] = to_bytes(tensors)
    try:
        write_folder(final, contents, FILES, "checkpoint")
    except RenetError as error:
        raise RenetError(
            f"{error}. Free the disk or choose a writable folder (--log-root, --out); earlier "
            "checkpoints are intact"
        ) from error
    others = [path for path in checkpoints(folder) if path != final]
    for old in others[: max(len(others) - keep + 1, 0)]:
        if foreign(old, FILES) is None:  # Else somebody keeps notes there.
            remove_folder(old, FILES)
    for torn in _torn(folder):
        remove_folder(torn, FILES)
    return final


def _torn(folder: Path) -> list[Path]:
    """What a kill left of checkpoints that were being removed: they have no state any more."""
    numbered = [path for path in folder.iterdir() if _numbered(path) and path.is_dir()]
    stateless = [path for path in numbered if not (path / "state.json").exists()]
    return [path for path in stateless if foreign(path, FILES) is None]


def checkpoints(folder: Path) -> list[Path]:
    """Complete checkpoints in a folder, oldest first."""
    return sorted(path.parent for path in folder.glob("*/state.json") if _numbered(path.parent))


def _numbered(folder: Path) -> bool:
    """Whether a folder is named as a checkpoint: by its iteration, in eight digits."""
    return re.fullmatch(r"it_\d{8}", folder.name) is not None and not folder.is_symlink()


def find(path: Path) -> Path:
    """The checkpoint `path` is, or the newest below a folder of runs, which is then printed.

    Newest is the highest iteration of the last run by name, which is its date: the times of files
    change when folders are copied. Raises RenetError where there is none.
    """
    if (path / "state.json").is_file():
        return path
    if not path.exists():
        raise RenetError(f"no checkpoint at {path}")
    below = [p.parent for p in path.glob("**/state.json") if _numbered(p.parent)]
    if not below:
        raise RenetError(f"no checkpoint in {path}: give a run folder or one of its it_* folders")
    checkpoint = max(below, key=lambda p: (_date(p.parent.parent), p.name))
    print(f"Checkpoint: {checkpoint}", file=sys.stderr)
    return checkpoint


def _date(run: Path) -> tuple[str, float]:
    """Sorts runs: by their folders' names, which begin with date and time; others come first."""
    dated = run.name[:4].isdigit()
    return (run.name if dated else "", run.stat().st_mtime)


def load(
    path: Path, device: str | torch.device = "cpu", model: nn.Module | None = None
) -> Checkpoint:
    """Read a checkpoint's folder, its tensors to a device.

    Raises:
        RenetError: a file is missing or damaged, or does not fit the model that the weights are
            for, with which headers are compared before any tensor takes memory.
    """
    state = load_state(path)
    tensors: dict[str, dict[str, Tensor]] = {"optimizer": {}, "average": {}}  # Not in all.
    try:
        for name in ("model", "environment", *tensors):
            file = path / f"{name}.safetensors"
            if name in tensors and not file.exists():
                continue
            shapes = header(file)
            if model is not None and shapes and name in ("model", "average"):
                load_model(deepcopy(model).to("meta"), shapes, path, assign=True)
            tensors[name] = load_file(file, device=str(device))
    except (OSError, ValueError, SafetensorError) as error:
        raise RenetError(f"checkpoint {path} is incomplete or damaged: {error}") from error
    return Checkpoint(**tensors, state=state)


def header(file: Path) -> dict[str, Tensor]:
    """Tensors of a file by name, without their values.

    Raises RenetError where it is no regular file or larger than any of renet's, and SafetensorError
    where it is not of tensors.
    """
    with safe_open(require_regular(file, MAX_TENSORS, "checkpoint's file"), "pt") as tensors:
        names = tensors.keys()
        shapes = {name: tensors.get_slice(name).get_shape() for name in names}
    return {name: torch.empty(shape, device="meta") for name, shape in shapes.items()}


def load_state(path: Path) -> dict[str, Any]:
    """Read a checkpoint's `state.json` alone; raises RenetError for one that no run can write."""
    state = read_object(path / "state.json", "checkpoint state")
    if (number := state.get("format")) != FORMAT:
        raise RenetError(f"{path} has checkpoint format {number}, this renet reads {FORMAT}")
    if not all(isinstance(state.get(name), dict) for name in ("agent", "env")):
        raise RenetError(f"{path} is not a checkpoint of RENet: it states no settings")
    for name, kind in STATE.items():
        if not isinstance(state.get(name), kind):
            raise RenetError(f"{path} is not a checkpoint of RENet: it states no {name}")
    return state


def check_model(model: ModelCfg, state: dict[str, Any], path: Path) -> None:
    """Refuse weights of another model, even where they would fit; raises RenetError."""
    stored, ours = state["agent"].get("model", {}), described(model)
    changes = [f"{k} was {v}, now {ours[k]}" for k, v in stored.items() if ours.get(k, v) != v]
    if changes:
        raise RenetError(
            f"{path} was trained with another model, so repeat its --agent.model options: "
            f"{'; '.join(changes)}"
        )


def load_model(
    module: nn.Module, tensors: dict[str, Tensor], path: Path, assign: bool = False
) -> None:
    """Load weights, or let `module` take the tensors themselves (`assign`).

    Raises RenetError for other names or shapes than the module's, with PyTorch's word on it.
    """
    try:
        module.load_state_dict(tensors, assign=assign)
    except RuntimeError as error:
        first = str(error).splitlines()[1].strip()[:200]
        raise RenetError(f"{path} is of another architecture: {first}") from error


def optimizer_tensors(optimizers: dict[str, Optimizer]) -> dict[str, Tensor]:
    """Adam's moments as flat names `optimizer/parameter/moment`."""
    return {
        f"{owner}/{index}/{name}": value
        for owner, optimizer in optimizers.items()
        for index, moments in optimizer.state_dict()["state"].items()
        for name, value in moments.items()
    }


def load_optimizers(optimizers: dict[str, Optimizer], tensors: dict[str, Tensor]) -> None:
    """Inverse of `optimizer_tensors`; the groups' settings stay as configured."""
    moments: dict[str, dict[int, dict[str, Tensor]]] = {owner: {} for owner in optimizers}
    for key, value in tensors.items():
        owner, index, name = key.split("/")
        moments[owner].setdefault(int(index), {})[name] = value
    for owner, optimizer in optimizers.items():
        optimizer.load_state_dict(optimizer.state_dict() | {"state": moments[owner]})
