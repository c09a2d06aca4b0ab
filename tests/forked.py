"""Processes of their own that begin with the large libraries loaded, which takes seconds."""

import gc
import multiprocessing
import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from subprocess import CompletedProcess

# Nothing of mjlab's and renet's: which is imported first matters.
LIBRARIES = """torch._dynamo tensordict rsl_rl.runners torch.utils.tensorboard mujoco_warp
mujoco.viewer scipy.interpolate matplotlib.pyplot mediapy onnxruntime viser"""
multiprocessing.set_forkserver_preload(LIBRARIES.split())


def fork(work: Callable[..., int | None], *arguments: object) -> CompletedProcess[str]:
    """Call a function of a module with arguments that can be pickled; its result is the code."""
    with tempfile.TemporaryDirectory() as folder:
        context = multiprocessing.get_context("forkserver")
        process = context.Process(target=_child, args=(folder, work, arguments))
        process.start()
        process.join(600.0)  # Some start in ten seconds on a busy computer; by now it hangs.
        process.kill()
        process.join()
        output, errors = (Path(folder, name).read_text() for name in ("1", "2"))
    assert process.exitcode is not None
    return CompletedProcess(arguments, process.exitcode, output, errors)


def _child(folder: str, work: Callable[..., int | None], arguments: tuple) -> None:
    gc.freeze()  # Whoever collects garbage need not look through the libraries.
    for descriptor in (1, 2):
        os.dup2(os.open(f"{folder}/{descriptor}", os.O_CREAT | os.O_WRONLY), descriptor)
    sys.exit(work(*arguments))
