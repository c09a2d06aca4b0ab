"""What a run did, in one figure and one small JSON, written when it ends."""

from __future__ import annotations

import json
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from renet.errors import RenetError
from renet.interface import CONSTRAINTS
from renet.training.metrics import read_curves

PANELS = (
    ("reward per episode", ("Train/mean_reward",)),
    ("episode length (steps)", ("Train/mean_episode_length",)),
    ("terrain level", "Curriculum/level/"),
    ("velocity tracking reward", ("Episode_Metrics/lin_vel_reward",)),
    ("collisions", ("Episode_Metrics/collisions",)),
    ("falls per reset step", ("Episode_Termination/fallen", "Episode_Termination/in_gap")),
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
"""Panel titles and their curves: names, or a prefix of names."""
SMOOTHING = 0.9
"""Weight of the past in the drawn moving average."""


def write_run_report(run: Path) -> Path:
    """Draw `curves.png` and write `report.json` (last smoothed values); returns the figure."""
    curves = read_curves(run)
    figure, axes = plt.subplots(4, 4, figsize=(16, 12), constrained_layout=True)
    last = {}
    for axis, (title, wanted) in zip(axes.flat, PANELS, strict=True):
        names = sorted(
            n for n in curves if (n.startswith(wanted) if isinstance(wanted, str) else n in wanted)
        )
        for name in names:
            iterations, values = curves[name]
            smooth = _smooth(values)
            last[name] = smooth[-1]
            axis.plot(iterations, smooth, label=name.split("/")[-1])
        axis.set_title(title)
        axis.set_xlabel("iteration")
        axis.grid(alpha=0.3)
        if len(names) > 1:
            axis.legend(fontsize=7)
    path = run / "curves.png"
    try:
        figure.savefig(path, dpi=70)
        (run / "report.json").write_text(json.dumps(last, indent=1) + "\n")
    except OSError as error:
        raise RenetError(f"cannot write the report of {run}: {error}") from error
    finally:
        plt.close(figure)
    return path


def _smooth(values: list[float]) -> list[float]:
    smooth = [values[0]]
    for value in values[1:]:
        smooth.append(SMOOTHING * smooth[-1] + (1.0 - SMOOTHING) * value)
    return smooth
