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

    Of an iteration that a resumed run repeated, the last value counts. A row that a killed run left
    incomplete is skipped, and so are the zeros that a power failure may leave in a file.

    Returns:
        Values by iteration, by the curve's name.

    Raises:
        RenetError: The file cannot be read.
    """
    curves: dict[str, dict[int, float]] = {}
    try:
        with file.open(newline="", errors="replace") as lines:
            text = (line.replace("\0", "") for line in lines)
            for row in csv.DictReader(text):
                with suppress(KeyError, TypeError, ValueError):
                    curves.setdefault(row["name"], {})[int(row["iteration"])] = float(row["value"])
    except (OSError, ValueError, csv.Error) as error:
        # A null byte in the path is a ValueError.
        raise RenetError(f"cannot read the curves {file}: {obstacle(error, file)}") from error
    return curves
