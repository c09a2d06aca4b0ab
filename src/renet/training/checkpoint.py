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
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from textwrap import shorten
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file
from safetensors.torch import save as to_bytes
from torch import Tensor, nn
from torch.optim import Optimizer
from torch.optim.swa_utils import AveragedModel

from renet.errors import RenetError
from renet.files import MEGABYTE, read_object, require_regular
from renet.folders import foreign, remove_folder, write_folder

FORMAT = 1
TENSORS = ("model", "average", "optimizer", "environment")
FILES = ("state.json", *(f"{name}.safetensors" for name in TENSORS))
"""All that a checkpoint's folder holds."""
UNTOLD = ("config.device", "config.processes", "config.hosts", "task_cfg.seed")
"""Settings that say how a run is carried out, not what it learns, or that are told elsewhere."""
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
    """Iteration, steps, adaptive learning rate, penalties, and the whole recipe."""
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
    return final


def checkpoints(folder: Path) -> list[Path]:
    """Complete checkpoints in a folder, oldest first."""
    return sorted(path.parent for path in folder.glob("*/state.json") if _numbered(path.parent))


def _numbered(folder: Path) -> bool:
    """Whether a folder is named as a checkpoint: by its iteration, in eight digits."""
    return re.fullmatch(r"it_\d{8}", folder.name) is not None and not folder.is_symlink()


def find(path: Path) -> Path:
    """The checkpoint `path` is, or the newest below it, which is then printed.

    Newest is the highest iteration of the last run by name, which is its date: the times of files
    change when folders are copied.

    Args:
        path: a checkpoint, a run folder or a folder of runs.

    Raises:
        RenetError: no checkpoint there.
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
    """Read a checkpoint.

    Args:
        path: of its folder. device: where its tensors are to be.
        model: what the weights are for; the files' headers are compared with it before any tensor
            takes memory.

    Raises:
        RenetError: a file is missing or damaged, or does not fit the model.
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

    Raises:
        RenetError: no regular file, or a larger one than any of renet's.
        SafetensorError: not of tensors.
    """
    with safe_open(require_regular(file, MAX_TENSORS, "checkpoint's file"), "pt") as tensors:
        names = tensors.keys()
        shapes = {name: tensors.get_slice(name).get_shape() for name in names}
    return {name: torch.empty(shape, device="meta") for name, shape in shapes.items()}


def load_state(path: Path) -> dict[str, Any]:
    """Read a checkpoint's `state.json` alone; raises RenetError where it is no such file."""
    state = read_object(path / "state.json", "checkpoint state")
    written = state.get("format")
    if written != FORMAT:
        raise RenetError(f"{path} has checkpoint format {written}, this renet reads {FORMAT}")
    state.pop("numpy_rng", None)  # Of older checkpoints; nothing draws from it.
    return state


def check_config(ours: dict[str, Any], theirs: dict[str, Any], path: Path) -> None:
    """Refuse weights of another model, even where they would fit; raises RenetError."""
    ours = json.loads(json.dumps(ours))  # Tuples are lists there.
    changed = [f"{k} was {v}, now {ours[k]}" for k, v in theirs.items() if ours.get(k, v) != v]
    if changed:
        raise RenetError(
            f"{path} was trained with another model, so repeat its --model options: "
            f"{'; '.join(changed)}"
        )


def load_model(
    module: nn.Module, tensors: dict[str, Tensor], path: Path, assign: bool = False
) -> None:
    """Load weights, or let `module` take the tensors themselves (`assign`).

    Raises:
        RenetError: other names or shapes than the module's, with PyTorch's word on it.
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


def described(value: Any) -> Any:
    """A configuration as JSON: dataclasses as dictionaries, functions and types by their names.

    Args:
        value: nested dataclasses, dictionaries, sequences, numbers and callables.
    """

    def plain(item: Any) -> Any:
        if is_dataclass(item) and not isinstance(item, type):
            return {f.name: getattr(item, f.name) for f in fields(item)}
        if callable(item):
            return f"{item.__module__}.{getattr(item, '__qualname__', type(item).__name__)}"
        return list(item) if isinstance(item, set) else str(item)

    return json.loads(json.dumps(value, default=plain))


def say_differences(before: Any, now: Any, name: str) -> None:
    """Print where two trees of JSON differ, as deep as both go.

    Args:
        before: settings, task rules or code version of a checkpoint that is resumed.
        now: those of the run that goes on. name: of both, with dots between levels.
    """
    before, now = _by_name(before), _by_name(now)
    if isinstance(before, dict) and isinstance(now, dict):
        for key in sorted(before.keys() | now.keys()):
            say_differences(before.get(key, "absent"), now.get(key, "absent"), f"{name}.{key}")
    elif before != now and name not in UNTOLD:
        print(f"{name} was {shorten(str(before), 80)}, now {shorten(str(now), 80)}")


def _by_name(value: Any) -> Any:
    """A list of objects, such as a scene's sensors, as a dictionary by their names or places."""
    if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
        return value
    return {item.get("name", str(place)): item for place, item in enumerate(value)}


class WeightAverage(AveragedModel):
    """Exponential moving average of a model's parameters and buffers, which is exported.

    Each gradient step leaves noise of its own in the weights. Their mean along a run has less of it
    (Izmailov et al. 2018, arXiv 1803.05407) and often walks better than any it is made of.
    """

    def __init__(self, model: nn.Module, over: int) -> None:
        """Start with the model's weights.

        Args:
            model: network on the device where it is to stay.
            over: updates the average reaches back, about; 1 keeps the newest weights alone.
        """
        super().__init__(model, avg_fn=self._average, use_buffers=True)
        self.over = over

    def _average(self, average: Tensor, newest: Tensor, updates: Tensor | int) -> Tensor:
        """Counts such as a normaliser's are taken over."""
        if not newest.is_floating_point():
            return newest
        # Reaches back a quarter of the run at most: early weights say nothing about later ones.
        return average.lerp(newest, 1.0 / max(1.0, min(self.over, (int(updates) + 1) / 4)))

    def load(self, tensors: dict[str, Tensor], updates: int) -> None:
        """Go on with an average that was saved after so many updates."""
        self.module.load_state_dict(tensors)
        self.n_averaged.fill_(updates)
