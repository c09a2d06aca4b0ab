"""A study without robots, whose parts other processes can make."""

import os
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection
from types import SimpleNamespace
from typing import Any, ClassVar

from renet.errors import RenetError
from renet.evaluation.results import Provenance
from renet.evaluation.study import Part, Study, Table
from renet.files import write_atomically
from renet.terminal import progress


class CountingEvaluator(SimpleNamespace):
    conditions = "training"
    training_sha256 = "0" * 64

    def provenance(self, seed: int) -> Provenance:
        return Provenance("none", "0" * 64, "none", seed)

    def make_policy(self, num_robots: int) -> None: ...


def end_at_start(connection: Connection, processors: list[int]) -> None:
    """End as a process that is killed while it starts: what it was sent is never read."""
    connection.poll(None)
    os._exit(9)


def end_when_ready(connection: Connection, processors: list[int]) -> None:
    """End as a process that is killed while it waits for its next parts."""
    connection.recv()
    connection.send(None)
    connection.poll(None)
    os._exit(9)


@dataclass(frozen=True)
class CountingStudy(Study):
    """Each part is a letter, the process that made it, and its processors."""

    letters: str = "abcde"
    fate: str = ""
    """What becomes of the part b: refused, broken, killed, endless."""

    name: ClassVar[str] = "counting"
    selectable: ClassVar[tuple[str, ...]] = ("fate",)

    def make_evaluator(self) -> Any:
        return CountingEvaluator()

    def parts(self, evaluator: Any) -> Mapping[str, Callable[[], Part]]:
        return {letter: partial(self.make, letter) for letter in self.letters}

    def make(self, letter: str) -> Part:
        for _ in progress(range(3), letter):
            time.sleep(0.01)
        if letter == "b" and self.fate == "refused":
            raise RenetError("b is refused")
        if letter == "b" and self.fate == "broken":
            raise ValueError("b is broken")
        if letter == "b" and self.fate == "killed":
            os._exit(9)
        if letter == "b" and self.fate == "endless":
            write_atomically(self.out / "begun", b"")
            time.sleep(1000)
        return {"number": ord(letter), "process": os.getpid(), "cpus": [*os.sched_getaffinity(0)]}

    def summarise(self, parts: Mapping[str, Part], evaluator: Any) -> dict[str, Any]:
        return {"runs": [{"letter": name, "number": p["number"]} for name, p in parts.items()]}

    def tables(self, summary: dict[str, Any]) -> list[Table]:
        return [("Letters", ("letter",), [(run["letter"],) for run in summary["runs"]])]
