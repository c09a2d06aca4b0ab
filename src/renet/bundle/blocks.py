"""A model run by several threads, each for some of the robots.

ONNX Runtime's own threads split every single operation, and spin while they wait for each other.
Where they split depends on the number of rows, so that a robot's results would depend, in the last
digit, on how many robots are in the batch.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import onnxruntime as ort

_BLOCK_ROWS = 32
"""Most rows of a block, so that its activations fit a processor's cache."""


class BlockSession:
    """Session that runs blocks of rows on several threads, with the methods of ONNX Runtime's."""

    def __init__(self, session: ort.InferenceSession, threads: int) -> None:
        """Run `session` on `threads` threads."""
        self._session = session
        self._threads = threads
        self._pool = ThreadPoolExecutor(threads, thread_name_prefix="model")

    def get_inputs(self) -> Sequence[Any]:
        """The model's inputs."""
        return self._session.get_inputs()

    def get_outputs(self) -> Sequence[Any]:
        """The model's outputs."""
        return self._session.get_outputs()

    def run(self, names: Sequence[str], feed: dict[str, np.ndarray]) -> list[np.ndarray]:
        """Return the outputs of these names, [N, ...] each, from inputs [N, ...]."""
        rows = len(next(iter(feed.values())))
        # As many blocks as threads, or more where blocks of that size would not fit the cache.
        blocks = max(min(self._threads, rows), -(-rows // _BLOCK_ROWS))
        edges = [rows * block // blocks for block in range(blocks + 1)]

        def run_block(start: int, end: int) -> Any:
            return self._session.run(names, {name: v[start:end] for name, v in feed.items()})

        parts = list(self._pool.map(run_block, edges[:-1], edges[1:]))
        return [np.concatenate(outputs) for outputs in zip(*parts, strict=True)]


Session = ort.InferenceSession | BlockSession
"""A model that is ready to run."""
