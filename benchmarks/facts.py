"""Where and how a benchmark ran; every result file carries it."""

from __future__ import annotations

import json
import os
import platform
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import date
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from renet.errors import RenetError
from renet.files import write_atomically

LOAD_BEFORE = os.getloadavg()[0]
"""Taken at import: later the benchmark's own work counts."""


def facts() -> dict[str, Any]:
    packages = ("mujoco", "mujoco-warp", "warp-lang", "mjlab", "torch", "onnxruntime", "numpy")
    return {
        # As it was typed: of `python -m`, sys.argv has the module's path.
        "command": " ".join(["python", *sys.orig_argv[1:]]),
        "date": date.today().isoformat(),
        "cpus": os.cpu_count(),
        "machine": platform.machine(),
        "load_before": LOAD_BEFORE,
        "versions": {name: number for name in packages if (number := version_of(name))},
    }


def version_of(package: str) -> str | None:
    """None for a package that is not installed: a robot has no training packages."""
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def spread(values: Sequence[float]) -> dict[str, float]:
    """Median, 90th and 99th percentile, and the largest of the values."""
    names, shares = ("p50", "p90", "p99", "max"), (50, 90, 99, 100)
    points = np.percentile(values, shares)
    return {name: round(float(point), 3) for name, point in zip(names, points, strict=True)}


@contextmanager
def errors_in_one_line() -> Iterator[None]:
    """What the user can put right ends in one line and exit code 2."""
    try:
        yield
    except RenetError as error:
        print(f"{Path(sys.argv[0]).stem}: {error}", file=sys.stderr)
        raise SystemExit(2) from error


def report(results: dict[str, Any], path: Path | None) -> None:
    """Print a table and, if asked, write JSON, whose folder is made.

    Raises:
        RenetError: The file cannot be written.
    """
    for name, value in results.items():
        shown = f"{value:,.4g}" if isinstance(value, float) else value
        shown = f"{len(value)} rows" if isinstance(value, list) else shown
        print(f"{name:<32} {shown}")
    if path is not None:
        text = json.dumps({**results, "facts": facts()}, indent=1) + "\n"
        write_atomically(path, text.encode(), "results")
