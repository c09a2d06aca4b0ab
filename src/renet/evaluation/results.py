"""Files of results: JSON, CSV and Markdown, written whole or not at all."""

from __future__ import annotations

import csv
import hashlib
import io
import json
import math
import os
import shlex
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

import renet
from renet.errors import RenetError, printable
from renet.files import read_object, write_atomically
from renet.version import commit

Row = TypeVar("Row", bound=Mapping[str, Any])
Table = tuple[str, tuple[str, ...], list[tuple[Any, ...]]]
"""Title, header and rows."""


@dataclass(frozen=True)
class Provenance:
    """Where numbers come from; every summary and figure carries it."""

    bundle: str
    """Name of the bundle."""
    bundle_hash: str
    """SHA-256 of its models and its selector, hexadecimal."""
    engine: str
    """Physics engine of the rollouts."""
    seed: int
    command: str = field(
        default_factory=lambda: shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])
    )
    """The command line that made them; this process's by default."""
    date: str = field(default_factory=lambda: datetime.now(UTC).isoformat(timespec="seconds"))
    """UTC, ISO 8601; now by default."""
    renet_version: str = renet.__version__
    commit: str | None = field(default_factory=commit)
    """Commit of the clone that renet runs from, if it does."""

    @property
    def line(self) -> str:
        """One line for the foot of a figure."""
        return (
            f"bundle {self.bundle} {self.bundle_hash[:10]} · seed {self.seed} · {self.engine}"
            f" engine · renet {self.renet_version} · {self.date[:10]} · {self.command}"
        )


def output_folder(path: Path) -> Path:
    """`path` as an existing folder; raises RenetError where it cannot be made or written to."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RenetError(f"cannot write results to {path}: {error.strerror}") from error
    if not os.access(path, os.W_OK):
        raise RenetError(f"cannot write results to {path}: permission denied")
    return path


def plain(value: Any) -> Any:
    """`value` with NumPy types made Python's, and NaN and infinity made None and "inf"."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, (np.ndarray, np.generic)):
        return plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if isinstance(value, float):
        if math.isinf(value):
            return str(value)
        return None if math.isnan(value) else round(value, 6)
    return value


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write valid JSON (no NaN), atomically."""
    text = json.dumps(plain(content), indent=2, allow_nan=False) + "\n"
    write_atomically(path, text.encode())


MAX_JSON = 64_000_000
"""Bytes of a summary or part; Python needs about 25 times the space."""


def read_results(path: Path) -> dict[str, Any]:
    """Read what `write_json` wrote; raises RenetError where it is missing, damaged or too large."""
    if not path.exists():
        raise RenetError(f"{path} does not exist: run the study that writes it first")
    try:
        return read_object(path, "result", MAX_JSON)
    except RenetError as error:
        raise RenetError(f"{error}; delete it and run the study again") from error


PARTS_FORMAT = 6
"""Increase it when the contents of parts change: older parts are then made anew."""


def part_path(folder: Path, name: str, key: dict[str, Any]) -> Path:
    """Where a part of a study is kept; `key` is what its numbers depend on."""
    key = plain(key | {"format": PARTS_FORMAT})
    digest = hashlib.sha256(json.dumps(key, sort_keys=True).encode()).hexdigest()
    return folder / f"{name}-{digest[:8]}.json"


def kept(
    folder: Path, name: str, key: dict[str, Any], make: Callable[[], dict[str, Any]]
) -> dict[str, Any]:
    """A finished part of a study: from an earlier run, or made and written to `folder` now.

    An interrupted study thus goes on where it stopped. Parts of another `key`, which is what a
    part's numbers depend on, lie beside it. Raises RenetError for an earlier part that is damaged
    or of other settings.
    """
    path = part_path(folder, name, key)
    key = plain(key | {"format": PARTS_FORMAT})
    if path.exists():
        part = read_results(path)
        if part.get("key") != key:
            raise RenetError(
                f"{path} is of other settings than its name says: delete it and run the study again"
            )
        return part
    part = plain(make()) | {"key": key}
    write_json(path, part)
    return part


def grouped(rows: Sequence[Row], *names: str) -> dict[tuple[Any, ...], list[Row]]:
    """Rows by their values of some columns, in the order in which these first occur."""
    groups: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault(tuple(row[name] for name in names), []).append(row)
    return groups


def write_csv(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write rows with the keys of the first as header, atomically."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(plain(row) for row in rows)
    write_atomically(path, text.getvalue().encode())


def markdown(table: Table) -> str:
    """A table under its title as Markdown; names from files are text and nothing else."""
    title, header, rows = table
    lines = [_line(header), _line(["---"] * len(header)), *map(_line, rows)]
    return f"## {escape(title)}\n\n" + "".join(lines)


def _line(cells: Sequence[object]) -> str:
    """A row of a table as Markdown."""
    return f"| {' | '.join(map(escape, cells))} |\n"


def escape(value: object) -> str:
    """A value as one line of Markdown in which nothing is markup."""
    line = printable(str(value))
    for character in "\\`*_[]<>|!":
        line = line.replace(character, f"\\{character}")
    return line


def write_summary(
    path: Path, title: str, tables: Sequence[Table], figures: Sequence[str], origin: Provenance
) -> None:
    """Write a study's results for people, as Markdown, atomically.

    Args:
        path: of the file.
        title: heading of the whole.
        tables: in their order.
        figures: names of pictures in the same folder.
        origin: provenance of the numbers.
    """
    sections = [f"# {escape(title)}\n", *map(markdown, tables)]
    if figures:
        sections.append("".join(f"![{name}]({name})\n\n" for name in figures).rstrip("\n") + "\n")
    facts = [(name.replace("_", " "), value) for name, value in vars(origin).items()]
    sections.append(markdown(("Provenance", ("", ""), facts)))
    write_atomically(path, "\n".join(sections).encode())
