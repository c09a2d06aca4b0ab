"""Checkpoints: safetensors and JSON, so that loading a file never runs code in it.

A checkpoint is a folder `it_00001234` with `model.safetensors`, `average.safetensors` (the mean of
the last weights, which is exported), `optimizer.safetensors`, `environment.safetensors` and
`state.json`. It is written beside its final name and renamed, so that
a killed process or a full disk leaves earlier checkpoints whole.
"""

import json
import os
import shutil
import sys
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from renet.errors import RenetError
from renet.files import MEGABYTE, read_object, require_regular

FORMAT = 1
PREFIX = "it_"
MAX_TENSORS = 4000 * MEGABYTE
"""Bytes of one file of tensors."""


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
    final = folder / f"{PREFIX}{iteration:08d}"
    partial = folder / f".{final.name}.partial"
    try:
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir(parents=True)
        for name in ("model", "average", "optimizer", "environment"):
            if not getattr(checkpoint, name) and name == "average":
                continue
            tensors = {
                k: v.detach().cpu().contiguous() for k, v in getattr(checkpoint, name).items()
            }
            save_file(tensors, partial / f"{name}.safetensors")
        state = {"format": FORMAT, "iteration": iteration, **checkpoint.state}
        (partial / "state.json").write_text(json.dumps(state, indent=1) + "\n")
        for file in partial.iterdir():  # On the disk before it counts as a checkpoint.
            with file.open("rb") as handle:
                os.fsync(handle.fileno())
        shutil.rmtree(final, ignore_errors=True)
        os.replace(partial, final)
    except (OSError, SafetensorError) as error:
        shutil.rmtree(partial, ignore_errors=True)
        raise RenetError(
            f"cannot write checkpoint {final}: {error}. Free the disk or choose a writable "
            "folder (--log-root, --out); earlier checkpoints are intact"
        ) from error
    others = [path for path in checkpoints(folder) if path != final]
    for old in others[: max(len(others) - keep + 1, 0)]:
        shutil.rmtree(old, ignore_errors=True)
    return final


def checkpoints(folder: Path) -> list[Path]:
    """Complete checkpoints in a folder, oldest first."""
    return sorted(path.parent for path in folder.glob(f"{PREFIX}*/state.json"))


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
    found = [
        p.parent
        for p in path.glob(f"**/{PREFIX}*/state.json")
        if p.parent.name.removeprefix(PREFIX).isdecimal()
    ]
    if not found:
        raise RenetError(
            f"no checkpoint in {path}: give a run folder or one of its {PREFIX}* folders"
        )
    runs = {p.parent.parent for p in found}
    newest = max(runs, key=_date)
    # A copy or a checkout changes the times of files, but not their iterations.
    checkpoint = max((p for p in found if p.parent.parent == newest), key=lambda p: p.name)
    print(f"Checkpoint: {checkpoint}", file=sys.stderr)
    return checkpoint


def _date(run: Path) -> tuple[str, float]:
    """Sorts runs: by their folders' names, which begin with date and time; others come first."""
    dated = run.name[:4].isdigit()
    return (run.name if dated else "", run.stat().st_mtime)


def load(path: Path, device: str | torch.device = "cpu") -> Checkpoint:
    """Read a checkpoint; raises RenetError naming the file that is missing or damaged."""
    state = load_state(path)
    try:
        tensors: dict[str, dict[str, Tensor]] = {"optimizer": {}, "average": {}}  # Not in all.
        for name in ("model", "environment", *tensors):
            if name not in tensors or (path / f"{name}.safetensors").exists():
                tensors[name] = load_file(_tensors(path, name), device=str(device))
    except (OSError, ValueError, SafetensorError) as error:
        raise RenetError(f"checkpoint {path} is incomplete or damaged: {error}") from error
    return Checkpoint(**tensors, state=state)


def load_state(path: Path) -> dict[str, Any]:
    """Read a checkpoint's `state.json` alone; raises RenetError where it is no such file."""
    state = read_object(path / "state.json", "checkpoint state")
    written = state.get("format")
    if written != FORMAT:
        raise RenetError(f"{path} has checkpoint format {written}, this renet reads {FORMAT}")
    return state


def _tensors(path: Path, name: str) -> Path:
    return require_regular(path / f"{name}.safetensors", MAX_TENSORS, "checkpoint's file")


def check_config(ours: dict[str, Any], theirs: dict[str, Any], path: Path) -> None:
    """Refuse weights of another model, even where they would fit; raises RenetError."""
    ours = json.loads(json.dumps(ours))  # Tuples are lists there.
    changed = [f"{k} was {v}, now {ours[k]}" for k, v in theirs.items() if ours.get(k, v) != v]
    if changed:
        raise RenetError(
            f"{path} was trained with another model, so repeat its --model options: "
            f"{'; '.join(changed)}"
        )


def load_model(module: nn.Module, tensors: dict[str, Tensor], path: Path) -> None:
    """Load weights; raises RenetError naming the first difference of architecture."""
    check_same_architecture(module.state_dict(), tensors, path)
    module.load_state_dict(tensors)


def check_same_architecture(
    expected: dict[str, Tensor], tensors: dict[str, Tensor], path: Path
) -> None:
    """Refuse weights of other names or shapes than expected; raises RenetError with the first."""
    for name, tensor in expected.items():
        if name not in tensors:
            raise RenetError(f"{path} is of another architecture: it lacks {name}")
        if tensors[name].shape != tensor.shape:
            raise RenetError(
                f"{path} is of another architecture: {name} is {tuple(tensors[name].shape)}, "
                f"expected {tuple(tensor.shape)}"
            )
    surplus = sorted(set(tensors) - set(expected))
    if surplus:
        raise RenetError(f"{path} is of another architecture: unexpected {surplus[0]}")


def optimizer_tensors(optimizer: torch.optim.Optimizer, prefix: str) -> dict[str, Tensor]:
    """Adam's moments as flat names `prefix/parameter/moment`."""
    return {
        f"{prefix}/{index}/{name}": torch.as_tensor(value)
        for index, moments in optimizer.state_dict()["state"].items()
        for name, value in moments.items()
    }


def load_optimizer(
    optimizer: torch.optim.Optimizer, tensors: dict[str, Tensor], prefix: str
) -> None:
    """Inverse of `optimizer_tensors`; the groups' settings stay as configured."""
    moments: dict[int, dict[str, Tensor]] = {}
    for key, value in tensors.items():
        owner, index, name = key.split("/")
        if owner == prefix:
            moments.setdefault(int(index), {})[name] = value
    groups = optimizer.state_dict()["param_groups"]
    optimizer.load_state_dict({"state": moments, "param_groups": groups})


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


class WeightAverage:
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
        self.over, self.updates = over, 0
        self.tensors = {name: value.clone() for name, value in model.state_dict().items()}

    @torch.no_grad()
    def update(self, model: nn.Module) -> None:
        """Take in the model's present weights; counts such as a normaliser's are taken over."""
        self.updates += 1
        # Reaches back a quarter of the run at most: early weights say nothing about later ones.
        share = 1.0 / max(1.0, min(self.over, self.updates / 4))
        for name, value in model.state_dict().items():
            if value.is_floating_point():
                self.tensors[name].lerp_(value, share)
            else:
                self.tensors[name].copy_(value)

    def load(self, tensors: dict[str, Tensor], updates: int) -> None:
        """Go on with an average that was saved after so many updates."""
        self.updates = updates
        for name, value in tensors.items():
            self.tensors[name].copy_(value)
