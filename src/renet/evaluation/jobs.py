"""Several processes that make a study's parts, each with its share of the processors.

A process has an evaluator of its own. It receives the names of one group of parts after the other,
makes them and keeps them on disk.
"""

from __future__ import annotations

import os
import pickle
import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import Progress, TaskID

from renet.errors import RenetError
from renet.terminal import ProgressLog, shows_bars, tell_progress

_NEWS_INTERVAL = 0.2
"""Shortest time between two messages about a part's progress, s."""
_EXIT_TIMEOUT = 20.0
"""Time that a process has to exit after it is told to, s."""


@dataclass(frozen=True)
class ProgressMessage:
    """Message of a process about the part it is making."""

    title: str
    """Title of the part."""
    done: int
    """Number of steps that are done."""
    total: int
    """Number of all steps."""


@dataclass(frozen=True)
class FailureMessage:
    """Message of a process that could not make a part."""

    reason: str
    """Why the part could not be made."""
    correctable: bool
    """True if the reason is the message of a RenetError; else it is a traceback."""


@dataclass
class Job:
    """A process that makes parts."""

    process: BaseProcess
    """The process."""
    connection: Connection
    """This end of the connection to it."""
    bar: TaskID
    """Its bar in the terminal."""
    parts: Sequence[str] = ()
    """Names of the parts it makes; none before the first."""


def make_parts(
    part_maker: Callable[[], Callable[[str], Any]], groups: Sequence[Sequence[str]], jobs: int
) -> None:
    """Make parts of a study, and keep them on disk.

    Args:
        part_maker: `Study.part_maker` of a study, which every process calls.
        groups: Names of the parts; one process makes those of a group.
        jobs: Number of processes.

    Raises:
        RenetError: The first that a process raised; or a process ended without a message; or the
            study is of a class that other processes cannot import.
    """
    try:
        pickled = pickle.dumps(part_maker)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise RenetError(f"--jobs needs a study that other processes can import: {error}") from None
    queue = list(groups)
    running: list[Job] = []
    count = sum(map(len, groups))
    log = ProgressLog(count)
    bars = Progress(console=Console(stderr=True), disable=not shows_bars())
    with bars, _terminating(running):
        whole = bars.add_task(f"{'parts':<24}", total=count)
        for processors in _divide_processors(jobs):
            bar = bars.add_task(f"{'starting':<24}", total=None)
            running.append(Job(*_start(pickled, processors), bar))
        while running:
            jobs_by_connection: dict[Any, Job] = {job.connection: job for job in running}
            for connection in wait(list(jobs_by_connection)):
                job = jobs_by_connection[connection]
                news = _receive(job)
                if isinstance(news, ProgressMessage):
                    title = f"{news.title:<24}"
                    bars.update(job.bar, description=title, completed=news.done, total=news.total)
                    if bars.disable:
                        log.tell(news.title, news.done, news.total, job.bar, len(job.parts))
                    continue
                # The job is ready for its next parts; an empty list ends it.
                bars.advance(whole, len(job.parts))
                log.finish(len(job.parts), job.bar)
                job.parts = queue.pop(0) if queue else ()
                # If the process has been killed meanwhile, its next message tells.
                with suppress(BrokenPipeError, ConnectionResetError):
                    job.connection.send(job.parts)
                if not job.parts:
                    # Remove it only after its exit: it must be known if Ctrl-C comes meanwhile.
                    job.process.join()
                    running.remove(job)
                    bars.remove_task(job.bar)


def _divide_processors(jobs: int) -> list[list[int]]:
    """Divide the processors among jobs; some share one if there are more jobs than processors."""
    processors = sorted(os.sched_getaffinity(0))
    shares = np.array_split(processors, min(jobs, len(processors)))
    return [shares[job % len(shares)].tolist() for job in range(jobs)]


def _start(pickled: bytes, processors: list[int]) -> tuple[BaseProcess, Connection]:
    """Start a process, and return it with this end of its connection."""
    # Forking a process with threads, such as PyTorch's, is not safe.
    context = get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_work, args=(theirs, processors), daemon=True)
    # A terminal sends Ctrl-C to all processes, but only this one handles it.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        process.start()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    theirs.close()
    # If the process has exited already, the job's first message tells.
    with suppress(BrokenPipeError):
        ours.send_bytes(pickled)
    return process, ours


def _receive(job: Job) -> ProgressMessage | None:
    """Receive the next message of a job; None: it is ready for parts.

    Raises RenetError for a failure that the user can correct, RuntimeError for any other.
    """
    try:
        news = job.connection.recv()
    # Linux resets a connection whose other end has ended without reading what it was sent.
    except (EOFError, ConnectionResetError):
        job.process.join()
        raise RenetError(
            f"the process that made {', '.join(job.parts) or 'nothing yet'} ended with code"
            f" {job.process.exitcode}; if memory was short, give fewer --jobs"
        ) from None
    if isinstance(news, FailureMessage):
        if news.correctable:
            raise RenetError(news.reason)
        raise RuntimeError(f"{', '.join(job.parts)} failed in a process:\n{news.reason}")
    return news


@contextmanager
def _terminating(jobs: list[Job]) -> Iterator[None]:
    """End the processes that still run when the block ends, also after an error or Ctrl-C."""
    try:
        yield
    finally:
        for job in jobs:
            job.process.terminate()
        for job in jobs:
            job.process.join(_EXIT_TIMEOUT)
            job.process.kill()
            job.process.join()
            job.connection.close()


def _work(connection: Connection, processors: list[int]) -> None:
    """Make the parts that the other end of the connection names, until it names none."""
    # An exit of Python's, unlike a kill, removes files that are half-written.
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))
    # Thread pools, which start with the imports below, have one thread for each processor.
    os.sched_setaffinity(0, processors)
    last = 0.0

    def tell(title: str, done: int, total: int) -> None:
        nonlocal last
        if time.monotonic() - last >= _NEWS_INTERVAL:
            last = time.monotonic()
            connection.send(ProgressMessage(title, done, total))

    tell_progress(tell)
    try:
        # Unpickling the study imports its modules, which start thread pools.
        part_maker = connection.recv()
        make = part_maker()
        connection.send(None)
        while names := connection.recv():
            for name in names:
                make(name)
            connection.send(None)
    except RenetError as error:
        connection.send(FailureMessage(str(error), correctable=True))
    except (EOFError, BrokenPipeError, ConnectionResetError):
        pass  # The other end has exited and waits for no parts.
    except Exception:
        connection.send(FailureMessage(traceback.format_exc(), correctable=False))
