"""`renet evaluate pictures`: what the tiles look like, and what the camera's errors do."""

from __future__ import annotations

from contextlib import redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import torch
from matplotlib.colors import LightSource

from renet.evaluation.results import output_folder
from renet.sim.camera_model import Intrinsics, mount_rotation
from renet.sim.depth_camera import MountCfg
from renet.sim.depth_noise import DepthNoiseCfg, add_noise
from renet.sim.raycast import TerrainScanner, scanner
from renet.tasks import make_env
from renet.tiles import TILE, tiles
from renet.vocabulary import DEPTH_RANGE, DEPTH_SHAPE

LEVELS = (1, 5, 10)
EYE = (0.55, 0.0, 0.33)
"""Where the pictured camera's robot stands on its tile, m from the middle, facing out."""


@dataclass(frozen=True)
class PicturesCfg:
    """Draw every tile and the camera's randomisation."""

    out: Path = Path("results/pictures")
    """Folder for tiles.png and camera.png."""
    seed: int = 0
    """Of the camera's errors."""


def run_pictures(cfg: PicturesCfg) -> Path:
    """Write both pictures; raises RenetError if the folder cannot be written."""
    out = output_folder(cfg.out)
    torch.manual_seed(cfg.seed)
    with redirect_stdout(StringIO()):
        env = make_env("Renet-Go1-Parkour", 1)
    terrain = env.scene.terrain
    assert terrain is not None
    assert terrain.terrain_origins is not None
    rays = scanner(env.sim.mj_model, "cpu")
    draw_tiles(rays, terrain.terrain_origins, out / "tiles.png")
    draw_camera(rays, terrain.terrain_origins, out / "camera.png")
    env.close()
    return out


def draw_tiles(rays: TerrainScanner, origins: torch.Tensor, path: Path) -> None:
    """Shaded relief of every kind of tile at three levels."""
    kinds = list(tiles())
    figure, axes = plt.subplots(
        len(LEVELS), len(kinds), figsize=(2.4 * len(kinds), 7.6), constrained_layout=True
    )
    side = torch.linspace(-TILE / 2, TILE / 2, 200)
    grid = torch.cartesian_prod(side, side)
    for row, level in enumerate(LEVELS):
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
            axis.set_xticks([-4, 0, 4])
            axis.set_yticks([-4, 0, 4])
    figure.savefig(path, dpi=80)
    plt.close(figure)


def draw_camera(rays: TerrainScanner, origins: torch.Tensor, path: Path) -> None:
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
    rows = ("true depth", "with range noise", "and mount errors")
    figure, axes = plt.subplots(
        len(rows), len(kinds), figsize=(2.4 * len(kinds), 6.2), constrained_layout=True
    )
    for column, kind in enumerate(kinds):
        # A middle level, seen from near the edge of the start.
        eye = origins[5, column] + torch.tensor(EYE) + torch.tensor(mount.position)
        true = _view(rays, eye, straight)
        images = (true, add_noise(true, DepthNoiseCfg()), _view(rays, eye + moved, turned))
        images = (*images[:2], add_noise(images[2], DepthNoiseCfg()))
        for row, image in enumerate(images):
            axis = axes[row, column]
            axis.imshow(image.clamp(0, DEPTH_RANGE), vmin=0, vmax=DEPTH_RANGE, cmap="magma_r")
            axis.set_xticks([])
            axis.set_yticks([])
            axis.set_title(f"{kind}: {rows[row]}" if row == 0 else rows[row], fontsize=9)
    figure.savefig(path, dpi=80)
    plt.close(figure)


def _view(rays: TerrainScanner, eye: torch.Tensor, rotation: torch.Tensor) -> torch.Tensor:
    """Planar depth [48, 64] m, the range where nothing is hit."""
    depth = rays.depth(eye[None], rotation, Intrinsics().rays(), DEPTH_RANGE).reshape(DEPTH_SHAPE)
    return torch.where(depth >= 0.0, depth, DEPTH_RANGE)
