"""Model files of other projects: ONNX and TorchScript."""

from __future__ import annotations

import warnings
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from textwrap import shorten
from typing import Any, Protocol

import numpy as np

from renet.errors import RenetError, printable
from renet.files import require_regular

MAX_POLICY_SIZE = 500_000_000
"""Largest size of a policy's file, bytes."""


class Model(Protocol):
    """A policy's network: arrays in, arrays out. A recurrent one keeps a state for each robot."""

    name: str
    """Name of the file, for error messages."""
    shapes: str
    """Shapes of the newest inputs and outputs, for error messages; empty before the first."""

    def run(self, *inputs: np.ndarray, robot: int = 0, method: str = "forward") -> list[np.ndarray]:
        """Evaluate the model on inputs in its own order, with the state of one robot.

        A TorchScript module may have methods beside `forward`; raises RenetError if it lacks one.
        """
        ...

    def reset(self, robot: int) -> None:
        """Clear the model's own state of a robot."""
        ...


def open_model(path: Path) -> Model:
    """Open a model file; raises RenetError if it is missing, damaged or of another kind.

    Args:
        path: `.onnx`, or `.pt` of `torch.jit.save`.
    """
    if not path.exists():
        raise RenetError(f"the policy {path} does not exist")
    # A pipe or a device would block the reader.
    require_regular(path, MAX_POLICY_SIZE, "policy")
    if path.suffix == ".onnx":
        return OnnxModel(path)
    if path.suffix in (".pt", ".pth", ".jit"):
        return TorchScriptModel(path)
    raise RenetError(f"{path} is neither .onnx nor TorchScript (.pt): export the policy to one")


class MisfitError(RenetError):
    """A model does not fit the adapter that runs it."""


def demand_shapes(path: Path, nodes: Sequence[Any], shapes: Mapping[str, tuple[int, ...]]) -> None:
    """Raise RenetError unless an ONNX policy has the inputs and outputs of a study.

    Args:
        path: File of the policy, for the message.
        nodes: Inputs and outputs of its session, with N robots as their first dimension.
        shapes: Shapes needed for one robot, by name.
    """
    batched = True
    row_shapes = {}
    present = []
    for node in nodes:
        shape = list(node.shape)
        # A dimension with a number instead of a name is a fixed batch size.
        batched &= bool(shape) and not isinstance(shape[0], int)
        row_shapes[node.name] = tuple(shape[1:])
        present.append(f"{node.name} {shape}")
    if row_shapes != shapes or not batched:
        raise RenetError(
            f"{path} has {', '.join(present)}; a study"
            " gives proprioception [N, 45] (no base velocity) and depth [N, 48, 64] in [0, 1], and"
            " holds the joint targets of actions [N, 12] with gains 40 and 1: compute what else the"
            " model needs in the policy's `step` (docs/measure.md, Your own policy)"
        )


def _line(error: Exception, number: int) -> str:
    """Return a line of an error's message, at most 160 characters; its type if it has none.

    Args:
        error: The error.
        number: Number of the line, 0 for the first and -1 for the last.
    """
    text = str(error).strip() or type(error).__name__
    return printable(shorten(text.splitlines()[number], 160, placeholder=" …"))


def _shapes(arrays: Sequence[np.ndarray]) -> str:
    """List the shapes of arrays in words."""
    return ", ".join(str(list(array.shape)) for array in arrays)


class OnnxModel:
    """An ONNX model, which has no state."""

    def __init__(self, path: Path) -> None:
        import onnxruntime as ort

        self.name = path.name
        self.shapes = ""
        options = ort.SessionOptions()
        # Idle threads of a pool spin, and take time from the simulator.
        options.intra_op_num_threads = 1
        options.log_severity_level = 4
        try:
            self._session = ort.InferenceSession(path, options, ["CPUExecutionProvider"])
        except Exception as error:
            raise RenetError(
                f"{path} is no ONNX model: {_line(error, 0)}; export the policy again"
            ) from None
        self._inputs = [node.name for node in self._session.get_inputs()]

    def run(self, *inputs: np.ndarray, robot: int = 0, method: str = "forward") -> list[np.ndarray]:
        """Evaluate the model on inputs in its own order."""
        if method != "forward":
            raise _method_error(self.name, method)
        if len(inputs) != len(self._inputs):
            raise MisfitError(
                f"{self.name} has the inputs {', '.join(map(printable, self._inputs))}, the"
                f" adapter gives {len(inputs)}"
            )
        feed = {}
        for name, value in zip(self._inputs, inputs, strict=True):
            feed[name] = np.ascontiguousarray(value, np.float32)
        try:
            outputs = list(map(np.asarray, self._session.run(None, feed)))
        except Exception as error:
            raise _input_error(self.name, inputs, error) from None
        self.shapes = f"inputs {_shapes(inputs)}, outputs {_shapes(outputs)}"
        return outputs

    def reset(self, robot: int) -> None:
        """Do nothing: there is no state."""


class TorchScriptModel:
    """A TorchScript module, with one copy for each robot whose state it keeps.

    A copy is loaded when its robot first needs it: a module without a state is loaded once.
    """

    def __init__(self, path: Path) -> None:
        import torch

        self.name = path.name
        self.shapes = ""
        self._torch = torch
        self._path = path
        self._modules: dict[int, Any] = {}
        """The copies that were needed so far, by robot."""
        self._module(0)

    def _module(self, robot: int) -> Any:
        """Return the robot's copy; raises RenetError if the file is no TorchScript module."""
        if robot not in self._modules:
            try:
                with warnings.catch_warnings(action="ignore"):
                    module = self._torch.jit.load(self._path, map_location="cpu")
            # PyTorch's own text is long, and about its internals.
            except Exception as error:
                path = self._path
                raise RenetError(f"{path} is no TorchScript module: {_kind(path)}") from error
            self._modules[robot] = module.eval()
        return self._modules[robot]

    def run(self, *inputs: np.ndarray, robot: int = 0, method: str = "forward") -> list[np.ndarray]:
        """Evaluate the robot's copy; returns all its tensors, those of nested tuples included."""
        torch = self._torch
        function = getattr(self._module(robot), method, None)
        if function is None:
            raise _method_error(self.name, method)
        tensors = []
        for value in inputs:
            tensors.append(torch.from_numpy(np.ascontiguousarray(value, np.float32)))
        try:
            with torch.inference_mode():
                outputs = function(*tensors)
        except Exception as error:
            raise _input_error(self.name, inputs, error) from None
        arrays = [tensor.detach().numpy() for tensor in _tensors(outputs)]
        self.shapes = f"inputs {_shapes(inputs)}, outputs {_shapes(arrays)}"
        return arrays

    def reset(self, robot: int) -> None:
        """Call the module's own `reset`, if it has one."""
        # A copy that was not needed yet has no state.
        reset = getattr(self._modules.get(robot), "reset", None)
        if reset is not None:
            reset()


def _kind(path: Path) -> str:
    """Say what a file is that PyTorch cannot open as TorchScript, and what to do about it."""
    export = "export the policy with torch.jit.script or trace"
    try:
        with zipfile.ZipFile(path) as archive:
            names = {Path(name).name for name in archive.namelist()}
    except zipfile.BadZipFile:
        return f"torch.jit.save did not write it: {export}"
    # `torch.save` and `torch.jit.save` write the same archive, but for the program.
    if "data.pkl" in names and "constants.pkl" not in names:
        return f"it is a checkpoint, which holds weights alone: {export}"
    return "it is damaged, or of a newer PyTorch"


def _tensors(outputs: Any) -> list[Any]:
    """List the tensors in nested tuples and lists, in their order, without anything else."""
    if not isinstance(outputs, (tuple, list)):
        return [outputs] if hasattr(outputs, "numpy") else []
    tensors = []
    for part in outputs:
        tensors += _tensors(part)
    return tensors


def _method_error(name: str, method: str) -> MisfitError:
    """Make the error for a model that lacks a method of the adapter's."""
    return MisfitError(
        f"{name} has no method {method}, which the adapter needs: make the file as"
        " docs/benchmark.md says"
    )


def _input_error(name: str, inputs: Sequence[np.ndarray], error: Exception) -> MisfitError:
    """Make the error for a model that does not take the adapter's inputs."""
    # TorchScript's traceback begins with the place and ends with the reason.
    reason = _line(error, -1)
    return MisfitError(f"{name} does not take inputs of shapes {_shapes(inputs)}: {reason}")
