"""Processes of their own that begin with the large libraries loaded, which takes seconds."""

import gc
import multiprocessing
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from subprocess import CompletedProcess

# Nothing of mjlab's and renet's: which is imported first matters.
LIBRARIES = """torch._dynamo tensordict rsl_rl.runners torch.utils.tensorboard mujoco_warp
mujoco.viewer scipy.interpolate matplotlib.pyplot mediapy onnxruntime viser"""
multiprocessing.set_forkserver_preload(LIBRARIES.split())

PATIENCE = 600.0
"""Seconds for a process: some start in ten on a busy computer; by then it hangs."""
Fork = Callable[..., CompletedProcess[str]]


def fork(work: Callable[..., int | None], *arguments: object) -> CompletedProcess[str]:
    """Call a function of a module with arguments that can be pickled; its result is the code."""
    context = multiprocessing.get_context("forkserver")

    def run(*call: object) -> int:
        return _end(context.Process(target=_child, args=call))

    return _completed(run, work, arguments)


@contextmanager
def forks() -> Iterator[Fork]:
    """A `fork` whose calls also begin with what earlier calls' modules have imported."""
    context = multiprocessing.get_context("forkserver")
    ours, theirs = context.Pipe()
    server = context.Process(target=_serve, args=(theirs,))
    server.start()
    theirs.close()

    def run(*call: object) -> int:
        ours.send(call)
        return ours.recv()

    try:
        yield lambda work, *arguments: _completed(run, work, arguments)
    finally:
        ours.close()
        server.join()


def _completed(
    run: Callable[..., int], work: Callable[..., int | None], arguments: tuple
) -> CompletedProcess[str]:
    with tempfile.TemporaryDirectory() as folder:
        code = run(folder, work, arguments)
        output, errors = (Path(folder, name).read_text() for name in ("1", "2"))
    return CompletedProcess(arguments, code, output, errors)


def _serve(calls: Connection) -> None:
    context = multiprocessing.get_context("fork")
    while True:
        try:
            call = calls.recv()  # Imports the module of the function that is called.
        except EOFError:
            return
        calls.send(_end(context.Process(target=_child, args=call)))


def _end(process: BaseProcess) -> int:
    """Start a process and wait for its end."""
    process.start()
    process.join(PATIENCE)
    process.kill()
    process.join()
    assert process.exitcode is not None
    return process.exitcode


def _child(folder: str, work: Callable[..., int | None], arguments: tuple) -> None:
    gc.freeze()  # Whoever collects garbage need not look through the libraries.
    for descriptor in (1, 2):
        os.dup2(os.open(f"{folder}/{descriptor}", os.O_CREAT | os.O_WRONLY), descriptor)
    sys.exit(work(*arguments))
