"""Processes of their own that begin with the large libraries loaded, which takes seconds."""

import gc
import multiprocessing
import os
import resource
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

TIMEOUT = 600.0
"""Seconds after which a process hangs; some start in ten on a busy computer."""
# Nothing of mjlab's and renet's: which is imported first matters.
LIBRARIES = """torch._dynamo tensordict rsl_rl.runners torch.utils.tensorboard mujoco_warp
mujoco.viewer scipy.interpolate matplotlib.pyplot mediapy onnxruntime viser"""
multiprocessing.set_forkserver_preload(LIBRARIES.split())


@dataclass
class Done:
    """What became of a process."""

    returncode: int
    stdout: str
    stderr: str
    peak: int
    """Kilobytes of memory, its own children's included."""


def fork(work: Callable[..., int | None], *arguments: object) -> Done:
    """Call a function of a module with arguments that can be pickled; its result is the code."""
    with tempfile.TemporaryDirectory() as folder:
        context = multiprocessing.get_context("forkserver")
        process = context.Process(target=_child, args=(folder, work, arguments))
        process.start()
        process.join(TIMEOUT)
        process.kill()
        process.join()
        said = {path.name: path.read_text() for path in Path(folder).iterdir()}
    assert process.exitcode is not None
    return Done(process.exitcode, said["1"], said["2"], int(said.get("peak", 0)))


def _child(folder: str, work: Callable[..., int | None], arguments: tuple) -> None:
    gc.freeze()  # Whoever collects garbage need not look through the libraries.
    for descriptor in (1, 2):
        os.dup2(os.open(f"{folder}/{descriptor}", os.O_CREAT | os.O_WRONLY), descriptor)
    try:
        sys.exit(work(*arguments))
    finally:
        sys.stdout.flush()
        kinds = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
        peak = max(resource.getrusage(kind).ru_maxrss for kind in kinds)
        Path(folder, "peak").write_text(str(peak))
