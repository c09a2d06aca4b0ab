"""Training curves: TensorBoard for looking, CSV for everything else."""

from __future__ import annotations

import csv
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from rsl_rl.utils.log_writer import LogWriter
from torch.utils.tensorboard import SummaryWriter

from renet.errors import RenetError

CURVES = "curves.csv"


class MetricsWriter(LogWriter):
    """rsl_rl log writer that also appends (iteration, name, value) rows to `curves.csv`.

    Rows are flushed once an iteration, so that a killed run keeps its curve; a resumed run appends.
    """

    def __init__(self, log_dir: str) -> None:
        self._path = Path(log_dir) / CURVES
        with self._writing():
            self._board = SummaryWriter(log_dir=log_dir, flush_secs=10)
            torn = _torn(self._path)
            self._file = self._path.open("a", newline="")
            self._rows = csv.writer(self._file)
            if self._file.tell() == 0:
                self._rows.writerow(("iteration", "name", "value"))
            elif torn:
                self._file.write("\n")
        self.latest: dict[str, float] = {}

    def add_scalar(self, tag: str, scalar_value: float, global_step: int) -> None:
        """Record one value at a learning iteration."""
        value = float(scalar_value)
        self.latest[tag] = value
        with self._writing():
            self._board.add_scalar(tag, value, global_step)
            if not tag.endswith("/time"):  # rsl_rl logs these against seconds, not iterations.
                self._rows.writerow((global_step, tag, f"{value:.6g}"))

    def flush(self) -> None:
        """Put rows on disk."""
        with self._writing():
            self._file.flush()

    def stop(self) -> None:
        """Close both files."""
        with self._writing():
            self._board.close()
            self._file.close()

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """Name the file that cannot be written; raises RenetError."""
        try:
            yield
        except OSError as error:
            raise RenetError(
                f"cannot write the curves {self._path}: {error}. Free the disk and go on with "
                "--resume; checkpoints are intact"
            ) from error


def _torn(path: Path) -> bool:
    """Whether the last row lacks its end: the run was killed while it was written."""
    if not path.exists() or path.stat().st_size == 0:
        return False
    with path.open("rb") as file:
        file.seek(-1, os.SEEK_END)
        return file.read() != b"\n"


def read_curves(run: Path) -> dict[str, tuple[list[int], list[float]]]:
    """Curves of a run by name: iterations and values; a resumed iteration's last value counts.

    A row that was torn when the run was killed is left out.
    """
    points: dict[str, dict[int, float]] = {}
    with (run / CURVES).open(newline="") as file:
        for row in csv.DictReader(file):
            with suppress(TypeError, ValueError):
                points.setdefault(row["name"], {})[int(row["iteration"])] = float(row["value"])
    return {name: (sorted(c), [c[i] for i in sorted(c)]) for name, c in points.items()}
