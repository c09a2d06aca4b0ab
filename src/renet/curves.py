"""Training curves on disk, `curves.csv`: rows of iteration, name and value."""

import csv
from contextlib import suppress
from pathlib import Path

from renet.errors import RenetError, reason

CURVES = "curves.csv"
"""Name of the file in a run's folder."""
STEPS = "Curriculum/environment_steps"
"""The curve that says how many environment steps were done."""
LEVEL = "Curriculum/level/"
"""Beginning of the names of the curriculum's levels, which end with the kind of tile."""


def read_curves(file: Path) -> dict[str, dict[int, float]]:
    """Curves by name, each a value by iteration; a resumed iteration's last value counts.

    A row that was torn when the run was killed is left out. Raises RenetError without a file.
    """
    curves: dict[str, dict[int, float]] = {}
    try:
        with file.open(newline="", errors="replace") as lines:
            for row in csv.DictReader(lines):
                with suppress(KeyError, TypeError, ValueError):
                    curves.setdefault(row["name"], {})[int(row["iteration"])] = float(row["value"])
    except (OSError, ValueError) as error:  # A path with a null byte is a ValueError.
        raise RenetError(f"cannot read the curves {file}: {reason(error)}") from error
    return curves
