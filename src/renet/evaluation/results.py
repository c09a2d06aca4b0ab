"""Files of results: JSON, CSV and Markdown, written atomically."""

from __future__ import annotations

import csv
import hashlib
import io
import json
import math
import os
import re
import shlex
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

import renet
from renet.errors import RenetError, obstacle, printable
from renet.files import read_object, write_atomically
from renet.version import commit

_Row = TypeVar("_Row", bound=Mapping[str, Any])
Table = tuple[str, tuple[str, ...], list[tuple[Any, ...]]]
"""Title, header and rows."""
MAX_RESULT_SIZE = 64_000_000
"""Largest size of a summary or part, bytes; Python needs about 25 times as much memory."""
PARTS_FORMAT = 6
"""Version of the contents of parts; increase it when these change, to make older parts anew."""


def command_line() -> str:
    """Return this process's command line, in which bytes that are no UTF-8 are replaced."""
    command = shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])
    # Python keeps such bytes of a file's name as surrogates, which cannot be written to a file.
    return command.encode("utf-8", "surrogateescape").decode("utf-8", "replace")


@dataclass(frozen=True)
class Provenance:
    """Origin of numbers: bundle, seed, command and code; part of every summary and figure."""

    bundle: str
    """Name of the bundle."""
    bundle_hash: str
    """SHA-256 of its models and its selector, hexadecimal."""
    engine: str
    """Physics engine of the rollouts."""
    seed: int
    """Seed of the numbers."""
    command: str = field(default_factory=command_line)
    """The command line that made the numbers; this process's by default."""
    date: str = field(default_factory=lambda: datetime.now(UTC).isoformat(timespec="seconds"))
    """Date and time in UTC, ISO 8601; now by default."""
    renet_version: str = renet.__version__
    """Version of renet."""
    commit: str | None = field(default_factory=commit)
    """Commit of the clone that renet runs from; None for an installed package."""

    @property
    def line(self) -> str:
        """The provenance as one line, for the foot of a figure."""
        return (
            f"bundle {self.bundle} {self.bundle_hash[:10]} · seed {self.seed} · {self.engine}"
            f" engine · renet {self.renet_version} · {self.date[:10]} · {self.command}"
        )


def output_folder(path: Path) -> Path:
    """Make a folder and return its path; raises RenetError if it cannot be made or written to."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RenetError(f"cannot write results to {path}: {obstacle(error, path)}") from error
    if not os.access(path, os.W_OK):
        raise RenetError(f"cannot write results to {path}: permission denied; give another folder")
    return path


def plain(value: Any) -> Any:
    """Convert a value for JSON: NumPy types to Python's, NaN to None, infinity to "inf"."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, (np.ndarray, np.generic)):
        return plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return list(map(plain, value))
    # JSON has no NaN and no infinity.
    if isinstance(value, float):
        if math.isinf(value):
            return str(value)
        return None if math.isnan(value) else round(value, 6)
    return value


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write JSON without NaN, atomically."""
    text = json.dumps(plain(content), indent=2, allow_nan=False) + "\n"
    write_atomically(path, text.encode())


def read_results(path: Path) -> dict[str, Any]:
    """Read a file of `write_json`; raises RenetError if it is missing, damaged or too large."""
    if not path.exists():
        raise RenetError(f"{path} does not exist: run the study that writes it first")
    try:
        return read_object(path, "result", MAX_RESULT_SIZE)
    except RenetError as error:
        raise RenetError(f"{error}; delete it and run the study again") from error


class PartMaker:
    """Maker of a study's parts, which it keeps on disk for the next run.

    An interrupted study continues from the parts that it has. Parts made with other settings lie
    beside them and are not used.
    """

    def __init__(
        self,
        folder: Path,
        key: Mapping[str, Any],
        makers: Mapping[str, Callable[[], dict[str, Any]]],
    ) -> None:
        """Prepare to make parts.

        Args:
            folder: Folder of the parts.
            key: All settings that the parts' numbers depend on.
            makers: Function that makes each part, by the part's name.
        """
        self.folder = folder
        self.makers = makers
        self._key = plain({**key, "format": PARTS_FORMAT})

    def _path(self, name: str) -> Path:
        """Return the path of a part, with the beginning of the key's hash in its name."""
        digest = hashlib.sha256(json.dumps(self._key, sort_keys=True).encode()).hexdigest()
        return self.folder / f"{name}-{digest[:8]}.json"

    def missing(self, names: Iterable[str]) -> list[str]:
        """List the parts that are not on disk."""
        return [name for name in names if not self._path(name).exists()]

    def check_kept(self) -> None:
        """Read all parts that are on disk, before others are made; raises as `__call__`."""
        for name in self.makers:
            if self._path(name).exists():
                self._read(name)

    def _read(self, name: str) -> dict[str, Any]:
        """Read a part from disk; raises as `__call__`."""
        path = self._path(name)
        part = read_results(path)
        if part.get("key") != self._key:
            raise RenetError(
                f"{path} is of other settings than its name says: delete it and run the study again"
            )
        return part

    def __call__(self, name: str) -> dict[str, Any]:
        """Read a part from disk, or make it and write it there.

        Raises RenetError for a file that is damaged or of other settings.
        """
        path = self._path(name)
        if path.exists():
            return self._read(name)
        part = plain(self.makers[name]()) | {"key": self._key}
        write_json(path, part)
        return part


def group_by(rows: Sequence[_Row], *names: str) -> dict[tuple[Any, ...], list[_Row]]:
    """Group rows by their values of some columns, in the order in which these first occur."""
    groups: dict[tuple[Any, ...], list[_Row]] = {}
    for row in rows:
        groups.setdefault(tuple(row[name] for name in names), []).append(row)
    return groups


def select(rows: Sequence[_Row], **values: Any) -> list[_Row]:
    """Select rows whose columns have the given values, such as `select(runs, mode="memory")`."""
    selection = []
    for row in rows:
        if all(row[name] == value for name, value in values.items()):
            selection.append(row)
    return selection


def column(rows: Sequence[Mapping[str, Any]], name: str) -> list[Any]:
    """Return the values of a column, one for each row."""
    return [row[name] for row in rows]


def as_text(value: float | None, form: str, scale: float = 1.0) -> str:
    """Format a number, scaled, such as by ".2f"; a dash if it was not measured."""
    return "-" if value is None else format(scale * value, form)


def table_rows(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return rows without the columns in which any of them has a list or a dictionary.

    A cell of a table holds neither. What was not measured is None in any column.
    """
    nested = set()
    for row in rows:
        nested |= {name for name, value in row.items() if isinstance(value, (list, dict))}
    return [{name: row[name] for name in row if name not in nested} for row in rows]


def write_csv(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write rows with the keys of the first as header, atomically."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(map(plain, rows))
    write_atomically(path, text.getvalue().encode())


def markdown(table: Table) -> str:
    """Format a table under its title as Markdown; text from files is escaped."""
    title, header, rows = table
    lines = [_line(header), _line(["---"] * len(header)), *map(_line, rows)]
    return f"## {_escape(title)}\n\n" + "".join(lines)


def _line(cells: Sequence[object]) -> str:
    """Format a row of a table as Markdown."""
    return f"| {' | '.join(map(_escape, cells))} |\n"


def _escape(value: object) -> str:
    """Format a value as one line of Markdown in which nothing is markup."""
    # Names of runs and files come from users.
    line = printable(str(value))
    for character in "\\`*_[]<>|!&~":
        line = line.replace(character, f"\\{character}")
    # Sites make links of bare addresses.
    return re.sub(r"(?i)(?<=:)(?=//)|(?<=www)(?=\.)", r"\\", line)


def write_summary(
    path: Path, title: str, tables: Sequence[Table], figures: Sequence[str], provenance: Provenance
) -> None:
    """Write a study's results as Markdown, atomically.

    Args:
        path: Path of the file.
        title: Heading of the file.
        tables: Its tables, in their order.
        figures: Names of pictures in the same folder.
        provenance: Provenance of the numbers.
    """
    sections = [f"# {_escape(title)}\n", *map(markdown, tables)]
    if figures:
        pictures = [f"![{name}]({name})\n" for name in figures]
        sections.append("\n".join(pictures))
    facts = [(name.replace("_", " "), value) for name, value in vars(provenance).items()]
    sections.append(markdown(("Provenance", ("", ""), facts)))
    write_atomically(path, "\n".join(sections).encode())
