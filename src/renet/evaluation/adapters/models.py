"""Opens the models that other people export: ONNX and TorchScript."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from renet.errors import RenetError, printable
from renet.files import require_regular

MAX_MODEL = 500_000_000
"""Bytes of a model."""


class Model(Protocol):
    """A function of arrays, of one robot each where it has a memory of its own."""

    name: str
    """The file's, for messages."""

    def run(self, *inputs: np.ndarray, robot: int = 0) -> list[np.ndarray]:
        """All outputs for the inputs in their order; robot: whose memory to use."""
        ...

    def reset(self, robot: int) -> None:
        """Forget what the model itself remembers of a robot."""
        ...


def open_model(path: Path, num_robots: int = 1) -> Model:
    """Open a file; raises RenetError where it is missing, damaged or of another kind.

    Args:
        path: `.onnx`, or `.pt` of `torch.jit.save`. num_robots: whose memories it may have to keep.
    """
    if not path.exists():
        raise RenetError(f"the policy {path} does not exist")
    require_regular(path, MAX_MODEL, "policy")
    if path.suffix == ".onnx":
        return OnnxModel(path)
    if path.suffix in (".pt", ".pth", ".jit"):
        return TorchScriptModel(path, num_robots)
    raise RenetError(f"{path} is neither .onnx nor TorchScript (.pt): export the policy to one")


def _first_line(error: Exception) -> str:
    text = str(error).strip() or type(error).__name__
    return printable(text.splitlines()[0][:160])


class OnnxModel:
    """An ONNX model, which remembers nothing."""

    def __init__(self, path: Path) -> None:
        import onnxruntime as ort

        self.name = path.name
        options = ort.SessionOptions()
        # Several threads would spin between operations.
        options.intra_op_num_threads = 1
        options.log_severity_level = 4
        try:
            self._session = ort.InferenceSession(path, options, ["CPUExecutionProvider"])
        except Exception as error:
            raise RenetError(f"{path} is no ONNX model: {_first_line(error)}") from None
        self._inputs = [node.name for node in self._session.get_inputs()]

    def run(self, *inputs: np.ndarray, robot: int = 0) -> list[np.ndarray]:
        """All outputs for the inputs in the model's order."""
        if len(inputs) != len(self._inputs):
            raise RenetError(
                f"{self.name} has the inputs {', '.join(map(printable, self._inputs))}, this"
                f" adapter gives {len(inputs)}: choose another --adapter"
            )
        feed = {
            name: np.ascontiguousarray(value, np.float32)
            for name, value in zip(self._inputs, inputs, strict=True)
        }
        try:
            return [np.asarray(output) for output in self._session.run(None, feed)]
        except Exception as error:
            raise mismatch(self.name, inputs, error) from None

    def reset(self, robot: int) -> None:
        """Nothing is remembered."""


class TorchScriptModel:
    """A TorchScript module; one copy for each robot whose memory it keeps."""

    def __init__(self, path: Path, num_robots: int) -> None:
        import torch

        self.name = path.name
        self._torch = torch
        try:
            with warnings.catch_warnings(action="ignore"):
                self._modules: list[Any] = [
                    torch.jit.load(path, map_location="cpu").eval() for _ in range(num_robots)
                ]
        except Exception as error:
            raise RenetError(
                f"{path} is no TorchScript module: {_first_line(error)}; a checkpoint holds weights"
                " alone: export it with torch.jit.script or trace"
            ) from None

    def run(self, *inputs: np.ndarray, robot: int = 0) -> list[np.ndarray]:
        """All tensors that the robot's copy returns, those in nested tuples, too."""
        torch = self._torch
        tensors = [torch.from_numpy(np.ascontiguousarray(value, np.float32)) for value in inputs]
        try:
            with torch.inference_mode():
                outputs = self._modules[robot](*tensors)
        except Exception as error:
            raise mismatch(self.name, inputs, error) from None
        return [tensor.numpy() for tensor in _flat(outputs)]

    def reset(self, robot: int) -> None:
        """Call the module's own `reset`, if it has one."""
        reset = getattr(self._modules[robot], "reset", None)
        if reset is not None:
            reset()


def _flat(outputs: Any) -> list[Any]:
    """The tensors of nested tuples and lists, in their order; what is none is left out."""
    if isinstance(outputs, (tuple, list)):
        return [tensor for part in outputs for tensor in _flat(part)]
    return [outputs] if hasattr(outputs, "numpy") else []


def mismatch(name: str, inputs: Sequence[np.ndarray], error: Exception) -> RenetError:
    """The error for a model that does not take what the adapter gives."""
    shapes = ", ".join(str(list(value.shape)) for value in inputs)
    # TorchScript's traceback begins with where, and ends with what.
    last = (str(error).strip().splitlines() or [type(error).__name__])[-1]
    return RenetError(
        f"{name} does not take inputs of shapes {shapes}: {printable(last.strip()[:160])};"
        " choose another --adapter"
    )
