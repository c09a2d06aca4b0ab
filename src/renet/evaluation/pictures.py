"""`renet evaluate pictures`: the tiles, the camera's errors, and the ground as VP predicts it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import torch
from matplotlib.colors import LightSource
from matplotlib.patches import Rectangle

from renet.camera import Intrinsics
from renet.deploy.policy import Policy
from renet.errors import RenetError
from renet.evaluation import figures
from renet.evaluation.lab import Lab
from renet.evaluation.maps import MapLog, draw_height_maps, errors
from renet.evaluation.play import robot_of
from renet.evaluation.results import Provenance, output_folder, write_json
from renet.evaluation.rollout import Row, run_rollout
from renet.evaluation.terminal import progress, show
from renet.interface import CONTROL_DT, DEPTH_RANGE
from renet.sim.depth.camera import MountCfg, mount_rotation
from renet.sim.depth.noise import DepthNoiseCfg, add_noise
from renet.sim.depth.raycast import TerrainScanner, scanner
from renet.tasks.parkour_env_cfg import parkour_env_cfg
from renet.terrain.tiles import LEVELS as TOP
from renet.terrain.tiles import TILE, tiles

LEVELS = (1, 5, 10)
EYE = (0.55, 0.0, 0.33)
"""Where the pictured camera's robot stands on its tile, m from the middle, facing out."""
SENSOR = Intrinsics(
    60, 106, 53 / math.tan(math.radians(87 / 2)), 30 / math.tan(math.radians(58 / 2)), 53, 30
)
"""All that a D435i sees, at an eighth of 848 x 480."""


@dataclass(frozen=True)
class PicturesCfg:
    """Draw every tile, the camera's randomisation, and predicted against true height maps."""

    out: Path = Path("results/pictures")
    """Folder for tiles.png, camera.png, height_map.png and summary.json."""
    bundle: Path | None = None
    """Bundle that predicts the height maps; the one that ships with renet by default."""
    level: int = 5
    """Level of the tiles for height maps, 1 to 10."""
    seconds: float = 6.0
    """How long the robots walk for height maps."""
    speed: float = 0.6
    """Commanded forward speed, m/s."""
    seed: int = 1
    """Of the camera's errors, and of the robots' starts."""
    engine: str = "auto"
    """Physics engine: auto, native or warp."""

    def __post_init__(self) -> None:
        if not 1 <= self.level <= TOP:
            raise RenetError(f"terrain level must be 1 to {TOP}, got {self.level}")
        if self.seconds < 2.0:
            raise RenetError(f"height maps need at least 2 seconds, got {self.seconds}")


def run_pictures(cfg: PicturesCfg) -> Path:
    """Write all pictures and return their folder.

    Raises:
        RenetError: a bundle that cannot be used, or a folder that cannot be written.
    """
    lab = Lab(cfg.bundle, cfg.engine)
    out = output_folder(cfg.out)
    kinds = list(tiles())
    task = parkour_env_cfg(play=True, robot=robot_of(lab.bundle.manifest))
    world = lab.world(task, range(len(kinds)), cfg.speed, cfg.seed)
    terrain = world.env.scene.terrain
    assert terrain is not None
    assert terrain.terrain_origins is not None
    rays = scanner(world.env.sim.mj_model, "cpu")
    torch.manual_seed(cfg.seed)
    provenance = lab.provenance(cfg.seed)
    draw_tiles(rays, terrain.terrain_origins, out / "tiles.png", provenance)
    draw_camera(rays, terrain.terrain_origins, out / "camera.png", provenance)
    world.place(np.full(len(kinds), cfg.level - 1), np.arange(len(kinds)))
    policy, rows = Policy(lab.bundle, len(kinds)), [Row("vp") for _ in kinds]
    log, steps = MapLog(policy, world), round(cfg.seconds / CONTROL_DT)
    with progress("robots look at tiles", steps) as advance:
        run_rollout(
            world,
            policy,
            lab.switch(len(kinds)),
            rows,
            steps,
            cfg.seed,
            on_step=advance,
            on_sight=log.note,
        )
    draw_height_maps(log.maps, kinds, out / "height_map.png", provenance)
    found = errors(log.maps, kinds)
    write_json(
        out / "summary.json",
        {
            "study": "pictures",
            "height_map": found,
            "settings": vars(cfg),
            "provenance": vars(provenance),
        },
    )
    _show(found)
    return out


def _show(found: list[dict[str, Any]]) -> None:
    """Print the errors of height maps."""
    rows = [
        (row["terrain"], f"{100 * row['rmse_m']:.1f}", f"{100 * row['rmse_of_flat_ground_m']:.1f}")
        for row in found
    ]
    show("Height maps of the VP estimator", ("terrain", "error (cm)", "of flat ground (cm)"), rows)


def draw_tiles(
    rays: TerrainScanner, origins: torch.Tensor, path: Path, provenance: Provenance
) -> None:
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
    figures.save(figure, path, provenance, dpi=80)


def draw_camera(
    rays: TerrainScanner, origins: torch.Tensor, path: Path, provenance: Provenance
) -> None:
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
            axis.set_xticks([])
            axis.set_yticks([])
            axis.set_title(f"{kind}: {rows[row]}" if row == 0 else rows[row], fontsize=9)
    figures.save(figure, path, provenance, dpi=80)


def _kept() -> tuple[tuple[float, float], float, float]:
    """Corner, width and height of the policy's image in the sensor's, in the sensor's pixels."""
    own = Intrinsics()
    width, height = own.width * SENSOR.fx / own.fx, own.height * SENSOR.fy / own.fy
    return (SENSOR.cx - width / 2, SENSOR.cy - height / 2), width, height


def _view(
    rays: TerrainScanner,
    eye: torch.Tensor,
    rotation: torch.Tensor,
    lens: Intrinsics | None = None,
) -> torch.Tensor:
    """Planar depth [rows, columns] m, the range where nothing is hit."""
    lens = lens or Intrinsics()
    depth = rays.depth(eye[None], rotation, lens, DEPTH_RANGE)
    depth = depth.reshape(lens.height, lens.width)
    return torch.where(depth >= 0.0, depth, DEPTH_RANGE)
