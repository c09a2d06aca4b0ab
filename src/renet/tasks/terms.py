"""Terms of mjlab's managers that are written in Warp, for one robot, and run for all at once."""

# Warp compiles annotations and arithmetic that pyright takes for Python's.
# pyright: reportGeneralTypeIssues=false, reportInvalidTypeForm=false, reportArgumentType=false
# pyright: reportCallIssue=false, reportOperatorIssue=false, reportReturnType=false

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache, wraps
from typing import TYPE_CHECKING, Any

import torch
import warp as wp
from torch import Tensor

from renet.tasks.step import Step

if TYPE_CHECKING:
    from renet.tasks.env import RenetEnv

Columns = tuple[tuple[int, Any], ...]
"""Functions in Warp and the column of a table that each fills, or its first."""


def per_robot(function: Callable) -> Callable[..., Tensor]:
    """Make a term of `function(step, robot)`, a number or a bool, in Warp's subset of Python.

    `judge.Judge` runs it once in each control step. The term, called with an environment, returns
    what it then was, [N]. Other functions in Warp cannot call it.
    """
    compiled = wp.func(function)

    @wraps(function)
    def term(env: RenetEnv) -> Tensor:
        return env.judge.value(term)

    term.compiled = compiled  # type: ignore[attr-defined]
    return term


def fills(size: int) -> Callable[[Callable], Callable[..., Tensor]]:
    """Make an observation of `function(step, robot, row, first)`, which fills columns of `row`.

    The term, called with an environment, returns [N, size] of its present state.
    """

    def decorate(function: Callable) -> Callable[..., Tensor]:
        compiled = wp.func(function)

        @wraps(function)
        def term(env: RenetEnv) -> Tensor:
            row = torch.zeros(env.num_envs, size, device=env.device)
            Launch(filling(((0, compiled),)), env.num_envs, [env.watched, row], env.device)()
            return row

        term.compiled, term.size = compiled, size  # type: ignore[attr-defined]
        return term

    return decorate


def is_in_warp(term: Callable) -> bool:
    """Whether one of the above made a term."""
    return hasattr(term, "compiled")


class Launch:
    """A kernel whose arguments are packed once; its threads are robots, or their columns, too."""

    def __init__(
        self, kernel: Any, shape: int | tuple[int, ...], inputs: Sequence[Any], device: str
    ) -> None:
        """Pack arguments: numbers, structs and tensors, which must stay where they are."""
        wp.init()  # `from_torch` does not.
        inputs = [wp.from_torch(i) if isinstance(i, Tensor) else i for i in inputs]
        self._keep = inputs  # What is packed are addresses.
        self._device = torch.device(device)
        self._launch = wp.launch(kernel, shape, inputs, device=str(device), record_cmd=True)

    def __call__(self) -> None:
        """Launch on torch's current stream."""
        if self._launch is None:  # A table without columns.
            return
        if self._device.type == "cpu":
            self._launch.launch()
        else:
            self._launch.launch(wp.stream_from_torch(torch.cuda.current_stream(self._device)))


@lru_cache(maxsize=32)
def filling(terms: Columns) -> Any:
    """The kernel of some observations."""

    @wp.kernel(module="unique", enable_backward=False)
    def fill(step: Step, table: wp.array2d(dtype=float)):
        robot = wp.tid()
        for i in range(wp.static(len(terms))):
            wp.static(terms[i][1])(step, robot, table, wp.static(terms[i][0]))

    return fill
