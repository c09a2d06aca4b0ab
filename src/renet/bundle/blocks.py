"""A model that several threads run side by side, each for some of the robots.

ONNX Runtime would split every single operation among its threads, which wait for each other by
spinning. And where it splits depends on the number of rows: a robot's results would depend, in
their last digit, on how many others walk beside it.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import onnxruntime as ort

BLOCK = 32
"""Most rows of a block; what a processor's cache holds."""


class BlockSession:
    """Runs a session of one thread for blocks of rows; its methods are those of the session."""

    def __init__(self, session: ort.InferenceSession, threads: int) -> None:
        self._session, self._threads = session, threads
        self._pool = ThreadPoolExecutor(threads, thread_name_prefix="model")

    def get_inputs(self) -> Sequence[Any]:
        """The model's inputs."""
        return self._session.get_inputs()

    def get_outputs(self) -> Sequence[Any]:
        """The model's outputs."""
        return self._session.get_outputs()

    def run(self, names: Sequence[str], feed: dict[str, np.ndarray]) -> list[np.ndarray]:
        """Outputs by their names, [N, ...] each, from inputs of as many rows."""
        rows = len(next(iter(feed.values())))
        blocks = max(min(self._threads, rows), -(-rows // BLOCK))
        edges = [rows * block // blocks for block in range(blocks + 1)]

        def run_block(start: int, end: int) -> Any:
            return self._session.run(names, {name: v[start:end] for name, v in feed.items()})

        parts = list(self._pool.map(run_block, edges[:-1], edges[1:]))
        return [np.concatenate(outputs) for outputs in zip(*parts, strict=True)]


Session = ort.InferenceSession | BlockSession
"""What runs a model."""
