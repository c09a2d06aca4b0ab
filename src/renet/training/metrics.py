"""Training curves: CSV beside TensorBoard or wandb during a run, and a figure at its end."""

import csv
import io
import json
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rsl_rl.utils.log_writer import LogWriter
from torch.utils.tensorboard import SummaryWriter

from renet.curves import CURVES, LEVEL, STEPS, read_curves
from renet.errors import RenetError, reason
from renet.files import append, write_atomically
from renet.interface import CONSTRAINTS
from renet.training.provenance import to_json

PANELS = (
    ("reward per episode", ("Train/mean_reward",)),
    ("episode length (steps)", ("Train/mean_episode_length",)),
    ("terrain level", LEVEL),
    ("velocity tracking reward", ("Episode_Metrics/lin_vel_reward",)),
    ("collisions", ("Episode_Metrics/collisions",)),
    (
        "robots fallen, per step with restarts",
        ("Episode_Termination/fallen", "Episode_Termination/in_gap"),
    ),
    ("action noise", ("Policy/mean_std",)),
    ("constraint costs", tuple(f"Loss/cost_{name}" for name in CONSTRAINTS)),
    ("velocity loss (m²/s²)", ("Loss/op_velocity", "Loss/vp_velocity")),
    ("map and feet loss (m²)", ("Loss/vp_height_map", "Loss/vp_feet_height")),
    ("HIM loss", ("Loss/op_him", "Loss/vp_him")),
    ("anomaly loss", ("Loss/anomaly",)),
    ("actor's learning rate", ("Loss/learning_rate",)),
    ("divergence per gradient step", ("Loss/kl",)),
    ("constraints' penalty, students' loss", ("Loss/cost", "Loss/imitation")),
    ("env-steps/s", ("Perf/total_fps",)),
)
"""Titles of the figure's panels, and their curves: a tuple of names, or a prefix of names."""
FEW_ITERATIONS = 20
"""Number of iterations up to which each is a point, because a line through one is invisible."""
MOST_COLUMNS = 4
"""Largest number of panels side by side."""
PAST_WEIGHT = 0.9
"""Weight of past values in the figure's exponential moving averages."""


class CurvesWriter(LogWriter):
    """Writer of curves to TensorBoard, to `curves.csv`, and to wandb if that is the logger.

    `curves.csv` has rows (iteration, name, value). Each goes to the disk at once, so that a killed
    run keeps its curves; a resumed run appends.
    """

    def __init__(self, log_dir: str, logger: str, project_name: str) -> None:
        """Open the files.

        Args:
            log_dir: Folder of the run.
            logger: Wandb or tensorboard.
            project_name: Project of the logger wandb.
        """
        self._path = Path(log_dir) / CURVES
        self._wandb = wandb_run(log_dir, project_name) if logger == "wandb" else None
        with self._report_errors():
            self._board = SummaryWriter(log_dir, flush_secs=10)
            self._file = append(self._path)
            self._rows = csv.writer(self._file)
            # An empty line ends a row that a killed run may have left incomplete.
            header = ("iteration", "name", "value")
            self._rows.writerow(() if self._file.tell() else header)
        self.latest: dict[str, float] = {}
        """Newest value of each curve."""

    def add_scalar(self, tag: str, scalar_value: float, global_step: int) -> None:
        """Record one value at a learning iteration."""
        # rsl_rl logs these curves against seconds in place of iterations.
        if tag.endswith("/time"):
            return
        value = float(scalar_value)
        self.latest[tag] = value
        with self._report_errors():
            self._board.add_scalar(tag, value, global_step)
            self._rows.writerow((global_step, tag, f"{value:.6g}"))
        if self._wandb:
            self._wandb.log({tag: value}, step=global_step)

    def store_config(self, env_cfg: dict | object, train_cfg: dict) -> None:
        """Record both configurations beside wandb's curves."""
        if self._wandb:
            self._wandb.config.update({"env": to_json(env_cfg), "agent": to_json(train_cfg)})

    def stop(self) -> None:
        """Close both files and end wandb's run."""
        with self._report_errors():
            self._board.close()
            self._file.close()
        if self._wandb:
            self._wandb.finish()

    @contextmanager
    def _report_errors(self) -> Iterator[None]:
        """Context that raises RenetError, with the file's name, where it cannot be written."""
        try:
            yield
        except OSError as error:
            raise RenetError(
                f"cannot write the curves {self._path}: {reason(error)}. Free the disk and go on "
                "with --resume; checkpoints are intact"
            ) from error


def wandb_run(log_dir: str, project_name: str) -> Any:
    """Begin a run of wandb.

    rsl_rl's own writer needs a setting that wandb no longer has.
    """
    try:
        import wandb
    except ModuleNotFoundError as error:
        raise RenetError("--agent.logger wandb needs it: pip install wandb") from error
    account = os.getenv("WANDB_USERNAME")
    config = {"log_dir": log_dir}
    return wandb.init(project=project_name, entity=account, name=Path(log_dir).name, config=config)


def write_run_report(run: Path) -> Path:
    """Draw the figure `curves.png`, and write the last smoothed values to `report.json`.

    Args:
        run: Folder of the run.

    Returns:
        Path of the figure.
    """
    curves = read_curves(run / CURVES)
    smooth = {}
    for name, values in curves.items():
        smooth[name] = dict(zip(sorted(values), _averages(values), strict=True))
    panels = _filled_panels(sorted(curves))
    # At least one place, for a run that ended at once.
    rows = math.ceil(max(len(panels), 1) / MOST_COLUMNS)
    columns = math.ceil(max(len(panels), 1) / rows)
    figure = Figure(figsize=(4.0 * columns, 3.0 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).flat
    last = {}
    for axis, (title, names) in zip(axes, panels.items(), strict=False):
        _draw_panel(axis, {name: smooth[name] for name in names}, curves.get(STEPS, {}))
        axis.set_title(title)
        last |= {name: list(smooth[name].values())[-1] for name in names}
    # The last row may still have more places than panels.
    for axis in list(figure.axes)[len(panels) :]:
        axis.set_axis_off()
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=70)
    write_atomically(run / "curves.png", picture.getvalue(), "report")
    write_atomically(run / "report.json", (json.dumps(last, indent=1) + "\n").encode(), "report")
    return run / "curves.png"


def _filled_panels(curves: Sequence[str]) -> dict[str, list[str]]:
    """Return the names of each panel's curves, by the panel's title, without empty panels."""
    panels = {}
    for title, pattern in PANELS:
        names = [name for name in curves if _belongs(name, pattern)]
        if names:
            panels[title] = names
    return panels


def _draw_panel(
    axis: Axes, curves: Mapping[str, Mapping[int, float]], steps: Mapping[int, float]
) -> None:
    """Draw curves, of values by iteration.

    Args:
        axis: Panel to draw in.
        curves: Values by iteration, by the curve's name.
        steps: Environment steps by iteration, which are the x-axis. A task without them has
            iterations there.
    """
    for name, values in curves.items():
        iterations = list(values)
        places = iterations
        if steps:
            known = sorted(steps)
            places = np.interp(iterations, known, [steps[i] / 1e6 for i in known])
        marker = "o" if len(iterations) <= FEW_ITERATIONS else ""
        label = name.split("/")[-1]
        axis.plot(places, list(values.values()), marker=marker, markersize=4, label=label)
    axis.set_xlabel("million steps" if steps else "iteration")
    axis.grid(alpha=0.3)
    if len(curves) > 1:
        axis.legend(fontsize=7)


def _belongs(name: str, pattern: str | tuple[str, ...]) -> bool:
    """Return True if a curve is in a panel, given as a prefix or as a tuple of names."""
    if isinstance(pattern, str):
        return name.startswith(pattern)
    return name in pattern


def _averages(values: Mapping[int, float]) -> Iterator[float]:
    """Return the exponential moving averages of a curve, given by iteration, in their order."""
    ordered = [values[iteration] for iteration in sorted(values)]
    return accumulate(ordered, lambda past, value: PAST_WEIGHT * past + (1 - PAST_WEIGHT) * value)
