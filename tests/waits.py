"""Where code would make the host of a GPU wait."""

import traceback
from pathlib import Path

import mjlab
import torch
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode

import renet

RENET = f"{Path(renet.__file__).parent}/"
MJLAB = f"{Path(mjlab.__file__).parent}/"
ALWAYS = ("_local_scalar_dense", "nonzero", "masked_select", "equal", "_linalg_svd")
"""Operations that wait whatever they are given; a decomposition asks whether it succeeded."""


class Waits(TorchDispatchMode):
    """Notes every operation whose result a host must have, or whose data it must copy."""

    def __init__(self) -> None:
        super().__init__()
        self._lists = _Lists(self)
        self.seen: set[str] = set()
        """All operations."""
        self.waits: list[str] = []
        """Those that wait."""
        self.files: list[str] = []
        """Files of renet in which they do; "mjlab" where it is none."""

    def __enter__(self):
        self._lists.__enter__()
        return super().__enter__()

    def __exit__(self, *error):
        super().__exit__(*error)
        self._lists.__exit__(*error)

    def note(self, name: str) -> None:
        """Add an operation that waits, called from where this is called."""
        calls = [frame.filename for frame in traceback.extract_stack()]
        files = [file for file in calls if file.startswith((RENET, MJLAB))]
        self.waits.append(name)
        self.files.append(
            Path(files[-1]).name if files and files[-1].startswith(RENET) else "mjlab"
        )

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        name = func.overloadpacket.__name__
        self.seen.add(name)
        masks = args[1] if name in ("index", "index_put", "index_put_") else ()
        by_mask = any(m is not None and m.dtype == torch.bool for m in masks)
        of_list = name == "lift_fresh" and args[0].ndim > 0
        if by_mask or of_list or name in ALWAYS:
            self.note(name)
        return func(*args, **(kwargs or {}))


class _Lists(TorchFunctionMode):
    """Notes lists made of tensors, for which nothing is dispatched on a CPU."""

    def __init__(self, watch: Waits) -> None:
        super().__init__()
        self._watch = watch

    def __torch_function__(self, func, types, args=(), kwargs=None):
        if func is torch.Tensor.tolist:
            self._watch.note("tolist")
        return func(*args, **(kwargs or {}))
