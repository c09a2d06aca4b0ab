"""Makes a study's parts in several processes, each of which has its share of the processors.

A process has an evaluator of its own, is given one part after the other, and keeps each on disk.
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
from typing import Any, Protocol

import numpy as np
from rich.console import Console
from rich.progress import Progress, TaskID

from renet.errors import RenetError
from renet.terminal import tell_progress

BETWEEN_NEWS = 0.2
"""Least time in seconds between two messages on a part's progress."""
PATIENCE = 20.0
"""Seconds that a process has for ending when it is told to."""


class Parted(Protocol):
    """A study, of a class that other processes can import."""

    def part_maker(self) -> Callable[[str], Any]:
        """What makes the parts by their names, and keeps them on disk."""
        ...


@dataclass(frozen=True)
class Progressed:
    """A process is making a part."""

    title: str
    done: int
    """Steps."""
    total: int


@dataclass(frozen=True)
class Failed:
    """A process could not make a part."""

    reason: str
    correctable: bool
    """Whether the reason is a RenetError's; else it is a traceback."""


@dataclass
class Job:
    """A process that makes parts."""

    process: BaseProcess
    connection: Connection
    bar: TaskID
    parts: Sequence[str] = ()
    """Names of the parts it makes; none before the first."""


def make_parts(study: Parted, groups: Sequence[Sequence[str]], jobs: int) -> None:
    """Make parts of a study, and keep them on disk.

    Args:
        study: its `make_evaluator` is called in every process.
        groups: names of the parts; one process makes those of a group. jobs: number of processes.

    Raises:
        RenetError: the first that a process raised; a process ended without a word; or the study
            is of a class that other processes cannot import.
    """
    try:
        pickled = pickle.dumps(study)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise RenetError(f"--jobs needs a study that other processes can import: {error}") from None
    waiting = list(groups)
    running: list[Job] = []
    with Progress(console=Console(stderr=True)) as bars, _ended(running):
        whole = bars.add_task(f"{'parts':<24}", total=sum(map(len, groups)))
        for processors in _shares(jobs):
            bar = bars.add_task(f"{'starting':<24}", total=None)
            running.append(Job(*_start(pickled, processors), bar))
        while running:
            for connection in wait([job.connection for job in running]):
                job = next(job for job in running if job.connection is connection)
                news = _received(job)
                if isinstance(news, Progressed):
                    title = f"{news.title:<24}"
                    bars.update(job.bar, description=title, completed=news.done, total=news.total)
                    continue
                bars.advance(whole, len(job.parts))
                job.parts = waiting.pop(0) if waiting else ()
                job.connection.send(job.parts)
                if not job.parts:
                    # It stays among those that run until it has ended: Ctrl-C may come meanwhile.
                    job.process.join()
                    running.remove(job)
                    bars.remove_task(job.bar)


def _shares(jobs: int) -> list[list[int]]:
    """Processors of each job; with more jobs than processors some share one."""
    processors = sorted(os.sched_getaffinity(0))
    shares = np.array_split(processors, min(jobs, len(processors)))
    return [shares[job % len(shares)].tolist() for job in range(jobs)]


def _start(pickled: bytes, processors: list[int]) -> tuple[BaseProcess, Connection]:
    """Start a process, and return it with this end of its connection."""
    # To fork a process with threads, such as PyTorch's, is not safe.
    context = get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_work, args=(theirs, processors), daemon=True)
    # A terminal sends Ctrl-C to all processes. Only this one is to speak of it.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        process.start()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    theirs.close()
    with suppress(BrokenPipeError):  # It has ended, which its job's first message says.
        ours.send_bytes(pickled)
    return process, ours


def _received(job: Job) -> Progressed | None:
    """The next message of a job; None: it is ready for parts. Raises RenetError for a failure."""
    try:
        news = job.connection.recv()
    except EOFError:
        job.process.join()
        raise RenetError(
            f"the process that made {', '.join(job.parts) or 'nothing yet'} ended with code"
            f" {job.process.exitcode}; if memory was short, give fewer --jobs"
        ) from None
    if isinstance(news, Failed):
        if news.correctable:
            raise RenetError(news.reason)
        raise RuntimeError(f"{', '.join(job.parts)} failed in a process:\n{news.reason}")
    return news


@contextmanager
def _ended(jobs: list[Job]) -> Iterator[None]:
    """End the processes that still run at the end, which is early after an error or Ctrl-C."""
    try:
        yield
    finally:
        for job in jobs:
            job.process.terminate()
        for job in jobs:
            job.process.join(PATIENCE)
            job.process.kill()
            job.process.join()
            job.connection.close()


def _work(connection: Connection, processors: list[int]) -> None:
    """Make the parts that the other end of the connection names, until it names none."""
    # Of these, Python's exit removes what is half-written.
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))
    # All thread pools, which begin with the imports below, count the processors.
    os.sched_setaffinity(0, processors)
    told = 0.0

    def tell(title: str, done: int, total: int) -> None:
        nonlocal told
        if time.monotonic() - told >= BETWEEN_NEWS:
            told = time.monotonic()
            connection.send(Progressed(title, done, total))

    tell_progress(tell)
    try:
        # The study comes only now, for its imports make thread pools.
        make = connection.recv().part_maker()
        connection.send(None)
        while names := connection.recv():
            for name in names:
                make(name)
            connection.send(None)
    except RenetError as error:
        connection.send(Failed(str(error), correctable=True))
    except (EOFError, BrokenPipeError, ConnectionResetError):
        pass  # The other end is gone: nobody waits for parts.
    except Exception:
        connection.send(Failed(traceback.format_exc(), correctable=False))
