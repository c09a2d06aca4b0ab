"""Checkpoints of safetensors and JSON, so that loading a file never runs code in it.

A checkpoint is a folder `it_00001234` with `model.safetensors`, `average.safetensors` (the mean of
the last weights, which is exported), `optimizer.safetensors`, `environment.safetensors` and
`state.json`. A folder is written atomically: a killed process or a full disk leaves earlier
checkpoints intact.
"""

import json
import re
import sys
from copy import deepcopy
from dataclasses import dataclass, field
from pathlib import Path
from textwrap import shorten
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file
from safetensors.torch import save as to_bytes
from torch import Tensor, nn
from torch.optim import Optimizer

from renet.errors import RenetError
from renet.files import MEGABYTE, is_temporary, read_object, require_regular
from renet.folders import foreign, remove_folder, write_folder
from renet.models.config import ModelCfg
from renet.training.provenance import to_json

FORMAT = 2
"""Version of the folder's contents."""
TENSORS = ("model", "average", "optimizer", "environment")
FILES = ("state.json", *(f"{name}.safetensors" for name in TENSORS))
"""Files of a checkpoint's folder."""
STATE_TYPES = {"iteration": int, "steps": int, "seconds": int | float, "task": str}
"""Names and types in every `state.json`, beside format and settings."""
MAX_TENSORS = 100 * MEGABYTE
"""Largest size of a file of tensors in bytes; the default networks need at most 16 MB."""


@dataclass
class Checkpoint:
    """Complete state of a run, from which it continues as if it had not stopped."""

    model: dict[str, Tensor]
    """Weights of all networks."""
    optimizer: dict[str, Tensor]
    """Adam's moments; empty in a checkpoint of weights alone, from which training continues with
    fresh moments."""
    environment: dict[str, Tensor]
    """Curriculum levels, command stage, and state of the random-number generators."""
    state: dict[str, Any] = field(default_factory=dict)
    """Iteration, steps, adaptive learning rate, penalty, and both configurations."""
    average: dict[str, Tensor] = field(default_factory=dict)
    """Mean of the last weights; empty in a checkpoint that has none."""

    @property
    def exported(self) -> dict[str, Tensor]:
        """Weights to evaluate and to export: the average if there is one."""
        return self.average or self.model


def save(checkpoint: Checkpoint, folder: Path, iteration: int, keep: int) -> Path:
    """Write a checkpoint atomically, and remove old ones.

    Args:
        checkpoint: State of the run.
        folder: Folder of the run's checkpoints.
        iteration: Number of finished iterations, which names the checkpoint.
        keep: Number of checkpoints to keep: this one and those of the highest iterations.

    Returns:
        Folder of the checkpoint.

    Raises:
        RenetError: A file cannot be written.
    """
    final = folder / f"it_{iteration:08d}"
    state = {"format": FORMAT, "iteration": iteration, **checkpoint.state}
    contents = {"state.json": (json.dumps(state, indent=1) + "\n").encode()}
    for part in TENSORS:
        tensors = {}
        for name, tensor in getattr(checkpoint, part).items():
            tensors[name] = tensor.detach().cpu().contiguous()
        contents[f"{part}.safetensors"] = to_bytes(tensors)
    try:
        write_folder(final, contents, FILES, "checkpoint")
    except RenetError as error:
        raise RenetError(
            f"{error}. Free the disk or choose a writable folder (--log-root, --out); earlier "
            "checkpoints are intact"
        ) from error
    others = [path for path in checkpoints(folder) if path != final]
    surplus = max(len(others) - keep + 1, 0)
    for old in others[:surplus]:
        # A folder with other files in it stays: somebody keeps notes there.
        if foreign(old, FILES) is None:
            remove_folder(old, FILES)
    for torn in _torn(folder):
        remove_folder(torn, FILES)
    return final


def _torn(folder: Path) -> list[Path]:
    """List checkpoints whose writing or removal was killed."""
    torn = []
    for path in folder.iterdir():
        # Without a state, it was being removed.
        removed = _has_checkpoint_name(path) and not (path / "state.json").exists()
        written = is_temporary(path.name) and path.name.startswith(".it_")
        regular = path.is_dir() and not path.is_symlink()
        if regular and (removed or written) and foreign(path, FILES) is None:
            torn.append(path)
    return torn


def checkpoints(folder: Path) -> list[Path]:
    """List the complete checkpoints in a folder, oldest first."""
    folders = [file.parent for file in folder.glob("*/state.json")]
    return sorted(path for path in folders if _has_checkpoint_name(path))


def _has_checkpoint_name(folder: Path) -> bool:
    """Return True for a folder named `it_` and the iteration in eight digits."""
    return re.fullmatch(r"it_\d{8}", folder.name) is not None and not folder.is_symlink()


def find(path: Path) -> Path:
    """Find a checkpoint: `path` itself, or the newest below a folder of runs, which is printed.

    The newest checkpoint is that of the highest iteration in the last run by name, which begins
    with its date. Times of files would not do: they change when folders are copied.

    Raises:
        RenetError: There is no checkpoint.
    """
    if (path / "state.json").is_file():
        return path
    if not path.exists():
        raise RenetError(f"no checkpoint at {path}")
    folders = [file.parent for file in path.glob("**/state.json")]
    candidates = [folder for folder in folders if _has_checkpoint_name(folder)]
    if not candidates:
        raise RenetError(f"no checkpoint in {path}: give a run folder or one of its it_* folders")
    checkpoint = max(candidates, key=lambda p: (_run_date(p.parent.parent), p.name))
    print(f"Checkpoint: {checkpoint}", file=sys.stderr)
    return checkpoint


def _run_date(run: Path) -> tuple[str, float]:
    """Return a key that sorts runs by date: their names, which begin with it, others first."""
    name = run.name if run.name[:4].isdigit() else ""
    return name, run.stat().st_mtime


def load_checkpoint(
    path: Path, device: str | torch.device = "cpu", model: nn.Module | None = None
) -> Checkpoint:
    """Read a checkpoint.

    Args:
        path: Folder of the checkpoint.
        device: Device of the tensors.
        model: Model that the weights are for. Their names and shapes are compared with it before
            any tensor takes memory.

    Raises:
        RenetError: A file is missing or damaged, or the weights do not fit the model.
    """
    state = load_state(path)
    # Files that a checkpoint may lack.
    tensors: dict[str, dict[str, Tensor]] = {"optimizer": {}, "average": {}}
    try:
        for name in ("model", "environment", *tensors):
            file = path / f"{name}.safetensors"
            if name in tensors and not file.exists():
                continue
            shapes = header(file)
            if model is not None and shapes and name in ("model", "average"):
                # Tensors on the device meta have shapes but take no memory.
                load_model(deepcopy(model).to("meta"), shapes, path, assign=True)
            tensors[name] = load_file(file, device=str(device))
    except (OSError, ValueError, SafetensorError) as error:
        raise RenetError(f"checkpoint {path} is incomplete or damaged: {error}") from error
    return Checkpoint(**tensors, state=state)


def header(file: Path) -> dict[str, Tensor]:
    """Read the names and shapes of a file's tensors, as tensors on the device meta.

    Raises:
        RenetError: The path is no regular file, or the file is larger than any that renet writes.
        SafetensorError: The file holds no tensors.
    """
    with safe_open(require_regular(file, MAX_TENSORS, "checkpoint's file"), "pt") as tensors:
        names = tensors.keys()
        shapes = {name: tensors.get_slice(name).get_shape() for name in names}
    return {name: torch.empty(shape, device="meta") for name, shape in shapes.items()}


def load_state(path: Path) -> dict[str, Any]:
    """Read a checkpoint's `state.json` alone.

    Raises:
        RenetError: The file cannot be read, or lacks what every run writes.
    """
    state = read_object(path / "state.json", "checkpoint state")
    number = state.get("format")
    if number != FORMAT:
        raise RenetError(f"{path} has checkpoint format {number}, this renet reads {FORMAT}")
    for name in ("agent", "env"):
        if not isinstance(state.get(name), dict):
            raise RenetError(f"{path} is not a checkpoint of RENet: it states no settings")
    for name, kind in STATE_TYPES.items():
        if not isinstance(state.get(name), kind):
            raise RenetError(f"{path} is not a checkpoint of RENet: it states no {name}")
    return state


def check_model(model: ModelCfg, state: dict[str, Any], path: Path) -> None:
    """Raise RenetError for weights of another model, even if their shapes fit.

    Args:
        model: Configuration of the model that is to load the weights.
        state: The checkpoint's `state.json`.
        path: Folder of the checkpoint, for the message.
    """
    stored = state["agent"].get("model", {})
    present = to_json(model)
    changes = []
    for name, value in stored.items():
        if present.get(name, value) != value:
            changes.append(f"{name} was {value}, now {present[name]}")
    if changes:
        raise RenetError(
            f"{path} was trained with another model, so repeat its --agent.model options: "
            f"{'; '.join(changes)}"
        )


def load_model(
    module: nn.Module, tensors: dict[str, Tensor], path: Path, assign: bool = False
) -> None:
    """Load weights into a module.

    Args:
        module: The module.
        tensors: Weights by name.
        path: Folder of the checkpoint, for the message.
        assign: Replace the module's tensors by these ones in place of copying their values.

    Raises:
        RenetError: Names or shapes are not the module's; the message quotes PyTorch's.
    """
    try:
        module.load_state_dict(tensors, assign=assign)
    except RuntimeError as error:
        first = shorten(str(error).splitlines()[1], 200, placeholder=" …")
        raise RenetError(f"{path} is of another architecture: {first}") from error


def optimizer_tensors(optimizers: dict[str, Optimizer]) -> dict[str, Tensor]:
    """Collect Adam's moments under flat names `optimizer/parameter/moment`."""
    tensors = {}
    for owner, optimizer in optimizers.items():
        for index, moments in optimizer.state_dict()["state"].items():
            for name, value in moments.items():
                tensors[f"{owner}/{index}/{name}"] = value
    return tensors


def load_optimizers(optimizers: dict[str, Optimizer], tensors: dict[str, Tensor]) -> None:
    """Load moments that `optimizer_tensors` collected; learning rates stay as configured."""
    moments: dict[str, dict[int, dict[str, Tensor]]] = {owner: {} for owner in optimizers}
    for key, value in tensors.items():
        owner, index, name = key.split("/")
        moments[owner].setdefault(int(index), {})[name] = value
    for owner, optimizer in optimizers.items():
        state = optimizer.state_dict()
        state["state"] = moments[owner]
        optimizer.load_state_dict(state)
        _follow_layouts(optimizer)


def _follow_layouts(optimizer: Optimizer) -> None:
    """Give moments the memory layouts of their parameters, which files do not keep.

    Fused Adam takes numbers as they lie in memory: moments of a convolution in another layout would
    belong to other weights of it.
    """
    for parameter, moments in optimizer.state.items():
        for name, value in moments.items():
            if value.shape == parameter.shape:
                moments[name] = torch.empty_like(parameter).copy_(value)
