"""Figures of the fault benchmark: survival at a glance, and what each fault looks like."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

from renet.evaluation import figures
from renet.evaluation.faults import FAULTS, SEVERITIES, Frames, Injection, Injector
from renet.evaluation.results import Provenance
from renet.vocabulary import DEPTH_SHAPE


def draw_survival(
    runs: list[dict[str, Any]],
    modes: Sequence[str],
    severities: Sequence[int],
    path: Path,
    provenance: Provenance,
) -> Path:
    """A table of colours: share of robots on their feet, faults × severities, mode by mode."""
    faults = list(dict.fromkeys(run["fault"] for run in runs))
    share = {(r["mode"], r["fault"], r["severity"]): 100 * r["survival"] for r in runs}
    with plt.rc_context({**figures.STYLE, "axes.grid": False, "axes.spines.left": False}):
        size = (2.2 + 2.1 * len(modes), 1.4 + 0.3 * len(faults))
        figure, axes = plt.subplots(1, len(modes), figsize=size, sharey=True, squeeze=False)
        for axis, mode in zip(axes[0], modes, strict=True):
            table = np.array([[share[mode, f, s] for s in severities] for f in faults])
            axis.imshow(table, vmin=0, vmax=100, cmap="RdYlGn", aspect="auto")
            for (row, column), value in np.ndenumerate(table):
                axis.text(column, row, f"{value:.0f}", ha="center", va="center", fontsize=8)
            axis.set_xticks(range(len(severities)), [str(s) for s in severities])
            axis.set_yticks(range(len(faults)), [f.replace("_", " ") for f in faults])
            axis.tick_params(length=0)
            axis.set(title=mode, xlabel="severity")
        figure.suptitle("Robots on their feet at the end (%)", x=0.01, ha="left", fontsize=11)
        return figures.save(figure, path, provenance)


def draw_gallery(faults: Sequence[str], seed: int, path: Path, provenance: Provenance) -> Path:
    """One picture of each fault at each severity; faults of time look like a healthy image."""
    framed: dict[Any, Any] = dict.fromkeys(("axes.spines.top", "axes.spines.right"), True)
    with plt.rc_context({**figures.STYLE, **framed, "axes.grid": False}):
        size = (1.6 * len(SEVERITIES) + 1.6, 1.22 * len(faults))
        figure, axes = plt.subplots(len(faults), len(SEVERITIES), figsize=size, squeeze=False)
        for row, fault in zip(axes, faults, strict=True):
            for axis, severity in zip(row, SEVERITIES, strict=True):
                axis.imshow(example(fault, severity, seed), cmap="gray", vmin=0, vmax=1)
                level = FAULTS[fault].level_of(severity)
                axis.set_title(
                    FAULTS[fault].describe(level), fontsize=8, loc="center", fontweight="normal"
                )
                axis.set(xticks=[], yticks=[])
            row[0].set_ylabel(fault.replace("_", " "), fontsize=8, rotation=0, ha="right")
        return figures.save(figure, path, provenance)


def example(fault: str, severity: int, seed: int) -> np.ndarray:
    """An image [48, 64] of ground and a block, half a second into the fault, base turning."""
    injector = Injector([(Injection.of(fault, severity, onset=0),)], [0], seed)
    rate = np.array([[0.0, 1.0, 2.0]])
    scene = block()[None]
    for step in range(0, 26, 5):
        frames = injector.apply(Frames.healthy(scene, rate), step)
    return frames.image[0]


def block() -> np.ndarray:
    """Depth [48, 64] as a camera 0.3 m above the ground sees a block 0.7 to 1.1 m ahead.

    The block is 0.5 m wide and 0.15 m high; the camera looks down by 30 degrees.
    """
    rows, columns = DEPTH_SHAPE
    height, tilt, focal = 0.3, np.radians(30), 0.5 * columns / np.tan(np.radians(43.5))
    down = (np.arange(rows) - rows / 2 + 0.5)[:, None] / focal * np.ones(columns)
    side = (np.arange(columns) - columns / 2 + 0.5) / focal
    drop = np.sin(tilt) + down * np.cos(tilt)
    ahead = np.maximum(np.cos(tilt) - down * np.sin(tilt), 1e-3)
    floor, top = (
        np.where(drop > 1e-3, clearance / np.maximum(drop, 1e-3), np.inf)
        for clearance in (height, height - 0.15)
    )
    face = 0.7 / ahead
    reach = top * ahead
    on_top = (reach > 0.7) & (reach < 1.1) & (np.abs(top * side) < 0.25)
    sunk = face * drop
    on_face = (sunk > height - 0.15) & (sunk < height) & (np.abs(face * side) < 0.25)
    depth = np.where(on_face, face, np.where(on_top, top, floor))
    return np.clip(depth / 2.0, 0.0, 1.0).astype(np.float32)
