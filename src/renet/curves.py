"""Training curves on disk, `curves.csv`: rows of iteration, name and value."""

import csv
from contextlib import suppress
from pathlib import Path

from renet.errors import RenetError, obstacle

CURVES = "curves.csv"
"""Name of the file in a run's folder."""
STEPS = "Curriculum/environment_steps"
"""Name of the curve of environment steps taken."""
LEVEL = "Curriculum/level/"
"""Prefix of the curves of the curriculum's levels; the kind of tile follows."""


def read_curves(file: Path) -> dict[str, dict[int, float]]:
    """Read the curves of a run.

    A run that was resumed repeats the iterations after its checkpoint: those that were lost do not
    count, also if it was stopped before it had repeated all of them. A row that a killed run left
    incomplete is skipped, and so are the zeros that a power failure may leave in a file.

    Returns:
        Values by iteration, by the curve's name.

    Raises:
        RenetError: The file cannot be read.
    """
    curves: dict[str, dict[int, float]] = {}
    newest = 0
    try:
        with file.open(newline="", errors="replace") as lines:
            text = (line.replace("\0", "") for line in lines)
            for row in csv.DictReader(text):
                with suppress(KeyError, TypeError, ValueError):
                    iteration = int(row["iteration"])
                    value = float(row["value"])
                    last = next(reversed(curves.get(row["name"], {})), -1)
                    # A file may also have one curve after the other.
                    if last >= iteration < newest:
                        curves = _until(curves, iteration)
                        newest = iteration
                    newest = max(newest, iteration)
                    curves.setdefault(row["name"], {})[iteration] = value
    except (OSError, ValueError, csv.Error) as error:
        # A null byte in the path is a ValueError.
        raise RenetError(f"cannot read the curves {file}: {obstacle(error, file)}") from error
    return curves


def _until(curves: dict[str, dict[int, float]], end: int) -> dict[str, dict[int, float]]:
    """Return the part of curves up to an iteration, without curves that begin later."""
    parts = {}
    for name, values in curves.items():
        kept = {iteration: value for iteration, value in values.items() if iteration <= end}
        if kept:
            parts[name] = kept
    return parts
