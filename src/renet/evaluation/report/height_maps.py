"""The height map VP predicts beside the true one, on every kind of tile."""

from collections.abc import Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from renet.bundle.policy import Policy
from renet.evaluation.env import SimEnv
from renet.evaluation.report.colormaps import RELIEF, as_seen
from renet.evaluation.rollout import UPDATES_PER_STEP
from renet.interface import HEIGHT_MAP_X, HEIGHT_MAP_Y
from renet.selector.monitors import SelectorInput
from renet.tasks.sensors import HEIGHT_MAP

WARM_UP = 50
"""Control steps after which a map counts: the estimator's memory begins empty."""
EXTENT = (-HEIGHT_MAP_Y[-1], -HEIGHT_MAP_Y[0], HEIGHT_MAP_X[0], HEIGHT_MAP_X[-1])
"""Right and ahead of the base, m."""


class MapLog:
    """Height maps of all robots at each control step of a rollout, predicted and true."""

    def __init__(self, policy: Policy, env: SimEnv) -> None:
        self._policy, self._sensor = policy, env.env.scene[HEIGHT_MAP]
        self._calls, self._maps = 0, []

    def note(self, seen: SelectorInput) -> None:
        """To be called at every update of the selector."""
        del seen
        if self._calls % UPDATES_PER_STEP == 0:
            true = self._sensor.data.numpy()
            self._maps.append(np.stack((self._policy.height_map, true), axis=1))
        self._calls += 1

    @property
    def maps(self) -> np.ndarray:
        """[T, N, 2, 132] m: the VP estimator's, then the terrain's."""
        return np.stack(self._maps)


def errors(maps: np.ndarray, kinds: Sequence[str]) -> list[dict[str, Any]]:
    """How far predictions are off on each tile, as root mean squares.

    Args:
        maps: [T, N, 2, 132] m, as `MapLog.maps`. kinds: N tiles.

    Returns:
        For each tile the error and, to compare with, that of taking all ground for flat.
    """
    predicted, true = maps[WARM_UP:, :, 0], maps[WARM_UP:, :, 1]
    return [
        {
            "terrain": kind,
            "rmse_m": float(np.sqrt(np.mean((predicted[:, n] - true[:, n]) ** 2))),
            "rmse_of_flat_ground_m": float(np.sqrt(np.mean(true[:, n] ** 2))),
        }
        for n, kind in enumerate(kinds)
    ]


def draw_height_maps(maps: np.ndarray, kinds: Sequence[str]) -> Figure:
    """True and predicted ground where each robot had the most relief around it.

    Args:
        maps: [T, N, 2, 132] m, as `MapLog.maps`. kinds: N tiles.
    """
    later = maps[WARM_UP:]
    steps = np.ptp(later[:, :, 1], axis=-1).argmax(axis=0)
    figure, axes = plt.subplots(
        2, len(kinds), figsize=(2.0 * len(kinds), 4.3), constrained_layout=True, squeeze=False
    )
    found = errors(maps, kinds)
    for n, kind in enumerate(kinds):
        predicted, true = later[steps[n], n]
        for axis, values in ((axes[0, n], true), (axes[1, n], predicted)):
            image = axis.imshow(
                as_seen(values), extent=EXTENT, vmin=-RELIEF, vmax=RELIEF, cmap="viridis"
            )
            axis.plot(0.0, 0.0, "^", color="white", markersize=5)
            axis.set_xticks([-0.5, 0.0, 0.5])
            axis.tick_params(labelsize=7)
        error, flat = found[n]["rmse_m"], found[n]["rmse_of_flat_ground_m"]
        axes[0, n].set_title(f"{kind.replace('_', ' ')}\ntrue", fontsize=9)
        axes[1, n].set_title(
            f"predicted\nerror {100 * error:.0f} cm (flat: {100 * flat:.0f})", fontsize=9
        )
    axes[0, 0].set_ylabel("m ahead", fontsize=8)
    axes[1, 0].set_ylabel("m ahead", fontsize=8)
    figure.colorbar(image, ax=axes, shrink=0.7, label="ground over the robot's own, m")
    return figure
