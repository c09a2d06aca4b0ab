"""Pictures of every tile, of the camera's errors, and of predicted beside true height maps.

`python tools/pictures.py --out docs/figures/pictures` draws those of docs/how_it_works.md.
"""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import count
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import torch
import tyro
from matplotlib.colors import LightSource
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from renet.camera import Intrinsics
from renet.evaluation import figures
from renet.evaluation.env import SimEnv
from renet.evaluation.evaluator import Evaluator
from renet.evaluation.results import output_folder, write_json
from renet.evaluation.rollout import Rollout, Trial
from renet.evaluation.settings import PARKOUR
from renet.evaluation.trace import UPDATES_PER_STEP
from renet.interface import DEPTH_RANGE, HEIGHT_MAP_X, HEIGHT_MAP_Y, control_steps
from renet.selector.monitors import SelectorInput
from renet.sim.depth.camera import DepthNoiseCfg, MountCfg, add_noise, mount_rotation
from renet.sim.depth.rasterizer import scanner
from renet.sim.depth.raycast import TerrainScanner
from renet.tasks.mdp.base_state import tile_terrain
from renet.tasks.sensors import HEIGHT_MAP
from renet.terrain.tiles import TILE, tiles

PICTURED_LEVELS = (1, 5, 10)
EYE = (0.55, 0.0, 0.33)
"""Where the pictured camera's robot stands on its tile, m from the middle, facing out."""
SENSOR = Intrinsics(
    60, 106, 53 / math.tan(math.radians(87 / 2)), 30 / math.tan(math.radians(58 / 2)), 53, 30
)
"""All that a D435i sees, at an eighth of 848 x 480."""
WARM_UP = 50
"""Control steps after which a map counts: the estimator's memory begins empty."""
EXTENT = (-HEIGHT_MAP_Y[-1], -HEIGHT_MAP_Y[0], HEIGHT_MAP_X[0], HEIGHT_MAP_X[-1])
"""Right and ahead of the base, m."""
RELIEF = 0.5
"""Metres of ground above or below the robot's own that end a height map's colours."""


@dataclass(frozen=True)
class Cfg:
    """Draw tiles.png, camera.png and height_map.png."""

    out: Path = Path("results/pictures")
    """Folder for the pictures and summary.json."""
    bundle: Path | None = None
    """Bundle folder; the one that ships with renet by default."""
    level: int = 5
    """Level of the tiles for height maps, 1 to 10."""
    seconds: float = 6.0
    """How long the robots walk for height maps, 2 or more."""
    seed: int = 1
    """Seed of the robots' bodies and starts and of the camera's errors."""


def main(cfg: Cfg) -> None:
    """Draw all pictures, and write the errors of the height maps."""
    evaluator, kinds = Evaluator(cfg.bundle, conditions="nominal"), list(tiles())
    env = evaluator.make_env(PARKOUR, range(len(kinds)), 0.6, cfg.seed)
    origins = tile_terrain(env.env).terrain_origins
    rays = scanner(env.env.sim.mj_model, "cpu")
    torch.manual_seed(cfg.seed)
    drawn = {"tiles.png": draw_tiles(rays, origins), "camera.png": draw_camera(rays, origins)}
    env.place(np.full(len(kinds), cfg.level - 1), np.arange(len(kinds)))
    rollout = evaluator.rollout(env, [Trial("camera") for _ in kinds], cfg.seed)
    maps = keep_maps(rollout, env)
    rollout.run(control_steps(cfg.seconds), "height maps of all tiles")
    drawn["height_map.png"] = draw_height_maps(np.stack(maps), kinds)
    out, provenance = output_folder(cfg.out), evaluator.provenance(cfg.seed)
    for name, figure in drawn.items():
        figures.save_figure(figure, out / name, provenance, dpi=80)
    content = {"runs": errors(np.stack(maps), kinds), "settings": asdict(cfg)}
    write_json(out / "summary.json", content | {"provenance": vars(provenance)})
    print(f"Results: {out}")


def draw_tiles(rays: TerrainScanner, origins: torch.Tensor) -> Figure:
    """Shaded relief of every kind of tile at three levels."""
    kinds = list(tiles())
    figure, axes = plt.subplots(
        len(PICTURED_LEVELS), len(kinds), figsize=(2.4 * len(kinds), 7.6), constrained_layout=True
    )
    side = torch.linspace(-TILE / 2, TILE / 2, 200)
    grid = torch.cartesian_prod(side, side)
    for row, level in enumerate(PICTURED_LEVELS):
        for column, kind in enumerate(kinds):
            origin = origins[level - 1, column]
            relief = rays.height(grid + origin[:2]).reshape(200, 200).numpy()
            axis = axes[row, column]
            shade = LightSource(315, 40).shade(
                relief, plt.get_cmap("cividis"), vmin=-1.2, vmax=1.2, blend_mode="soft"
            )
            axis.imshow(shade, extent=(-4, 4, -4, 4), origin="lower")
            low, high = relief.min(), relief.max()
            axis.set_title(f"{kind}, level {level}\n{low:+.2f} to {high:+.2f} m", fontsize=9)
            axis.set(xticks=[-4, 0, 4], yticks=[-4, 0, 4])
    return figure


def draw_camera(rays: TerrainScanner, origins: torch.Tensor) -> Figure:
    """One view per tile: true, then with range noise, then with mount errors as well."""
    kinds = list(tiles())
    mount = MountCfg()
    error = torch.empty(5).uniform_(-1.0, 1.0)
    turned = mount_rotation(
        torch.tensor([mount.pitch + mount.angle_error * error[0].item()]),
        torch.tensor([mount.angle_error * error[1].item()]),
    )
    straight = mount_rotation(torch.tensor([mount.pitch]), torch.tensor([0.0]))
    moved = mount.position_error * error[2:]
    rows = ("the sensor's view", "edges cut off", "with range noise", "and mount errors")
    figure, axes = plt.subplots(
        len(rows), len(kinds), figsize=(2.4 * len(kinds), 7.6), constrained_layout=True
    )
    kept = _kept()
    for column, kind in enumerate(kinds):
        # A middle level, seen from near the edge of the start.
        eye = origins[5, column] + torch.tensor(EYE) + torch.tensor(mount.position)
        true = _view(rays, eye, straight)
        images = (
            _view(rays, eye, straight, SENSOR),
            true,
            add_noise(true, DepthNoiseCfg()),
            add_noise(_view(rays, eye + moved, turned), DepthNoiseCfg()),
        )
        axes[0, column].add_patch(Rectangle(*kept, fill=False, edgecolor="tab:cyan", linewidth=1.5))
        for row, image in enumerate(images):
            axis = axes[row, column]
            axis.imshow(image.clamp(0, DEPTH_RANGE), vmin=0, vmax=DEPTH_RANGE, cmap="magma_r")
            axis.set(xticks=[], yticks=[])
            axis.set_title(f"{kind}: {rows[row]}" if row == 0 else rows[row], fontsize=9)
    return figure


def _kept() -> tuple[tuple[float, float], float, float]:
    """Corner, width and height of the policy's image in the sensor's, in the sensor's pixels."""
    lens = Intrinsics()
    width, height = lens.width * SENSOR.fx / lens.fx, lens.height * SENSOR.fy / lens.fy
    return (SENSOR.cx - width / 2, SENSOR.cy - height / 2), width, height


def _view(
    rays: TerrainScanner, eye: torch.Tensor, rotation: torch.Tensor, lens: Intrinsics | None = None
) -> torch.Tensor:
    """Planar depth [rows, columns] m, the range where nothing is hit."""
    lens = lens or Intrinsics()
    depth = rays.depth(eye[None], rotation, lens, DEPTH_RANGE)
    depth = depth.reshape(lens.height, lens.width)
    return torch.where(depth >= 0.0, depth, DEPTH_RANGE)


def keep_maps(rollout: Rollout, env: SimEnv) -> list[np.ndarray]:
    """Let a rollout keep the robots' height maps, predicted and true.

    Returns:
        A list that every control step of the rollout extends by [N, 2, 132] m: the VP estimator's
        map, then the terrain's.
    """
    maps, sensor, updates = [], env.env.scene[HEIGHT_MAP], count()

    def keep(seen: SelectorInput) -> None:
        if next(updates) % UPDATES_PER_STEP == 0:
            maps.append(np.stack((rollout.policy.height_map, sensor.data.numpy()), axis=1))

    rollout.on_update = keep
    return maps


def as_seen(height_map: np.ndarray) -> np.ndarray:
    """Heights of the ground [12, 11] m of a height map [132], from above: ahead is up.

    A height map is the robot's height over the ground: its negative is the ground's.
    """
    return -height_map.reshape(len(HEIGHT_MAP_X), len(HEIGHT_MAP_Y))[::-1, ::-1]


def errors(maps: np.ndarray, kinds: Sequence[str]) -> list[dict[str, Any]]:
    """How far predictions are off on each tile, as root mean squares.

    Args:
        maps: [T, N, 2, 132] m, as `keep_maps`. kinds: N tiles.

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
        maps: [T, N, 2, 132] m, as `keep_maps`. kinds: N tiles.
    """
    later = maps[WARM_UP:]
    steps = np.ptp(later[:, :, 1], axis=-1).argmax(axis=0)
    figure, axes = plt.subplots(
        2, len(kinds), figsize=(2.0 * len(kinds), 4.3), constrained_layout=True, squeeze=False
    )
    measured = errors(maps, kinds)
    for n, kind in enumerate(kinds):
        predicted, true = later[steps[n], n]
        for axis, values in ((axes[0, n], true), (axes[1, n], predicted)):
            image = axis.imshow(
                as_seen(values), extent=EXTENT, vmin=-RELIEF, vmax=RELIEF, cmap="viridis"
            )
            axis.plot(0.0, 0.0, "^", color="white", markersize=5)
            axis.set_xticks([-0.5, 0.0, 0.5])
            axis.tick_params(labelsize=7)
        error, flat = measured[n]["rmse_m"], measured[n]["rmse_of_flat_ground_m"]
        axes[0, n].set_title(f"{kind.replace('_', ' ')}\ntrue", fontsize=9)
        axes[1, n].set_title(
            f"predicted\nerror {100 * error:.0f} cm (flat: {100 * flat:.0f})", fontsize=9
        )
    axes[0, 0].set_ylabel("m ahead", fontsize=8)
    axes[1, 0].set_ylabel("m ahead", fontsize=8)
    figure.colorbar(image, ax=axes, shrink=0.7, label="ground over the robot's own, m")
    return figure


if __name__ == "__main__":
    main(tyro.cli(Cfg))
