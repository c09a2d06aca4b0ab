"""`renet evaluate pictures`: the tiles, the camera's errors, and the ground as VP predicts it."""

import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, ClassVar

import matplotlib.pyplot as plt
import numpy as np
import torch
from matplotlib.colors import LightSource
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from renet.bundle.policy import Policy
from renet.camera import Intrinsics
from renet.errors import RenetError
from renet.evaluation import figures
from renet.evaluation.env import PARKOUR
from renet.evaluation.evaluator import Evaluator
from renet.evaluation.report.height_maps import MapLog, draw_height_maps, errors
from renet.evaluation.results import output_folder, plain, write_json
from renet.evaluation.rollout import Trial
from renet.evaluation.study import Study, Table
from renet.interface import CONTROL_DT, DEPTH_RANGE
from renet.sim.depth.camera import DepthNoiseCfg, MountCfg, add_noise, mount_rotation
from renet.sim.depth.rasterizer import scanner
from renet.sim.depth.raycast import TerrainScanner
from renet.tasks.mdp.base_state import tile_terrain
from renet.terrain.tiles import LEVELS, TILE, tiles

PICTURED_LEVELS = (1, 5, 10)
EYE = (0.55, 0.0, 0.33)
"""Where the pictured camera's robot stands on its tile, m from the middle, facing out."""
SENSOR = Intrinsics(
    60, 106, 53 / math.tan(math.radians(87 / 2)), 30 / math.tan(math.radians(58 / 2)), 53, 30
)
"""All that a D435i sees, at an eighth of 848 x 480."""


@dataclass(frozen=True)
class PicturesStudy(Study):
    """Pictures of every tile, of the camera's errors, and of predicted beside true height maps."""

    out: Path = Path("results/pictures")
    """Folder for tiles.png, camera.png, height_map.png and summary.json."""
    level: int = 5
    """Level of the tiles for height maps, 1 to 10."""
    seconds: float = 6.0
    """How long the robots walk for height maps."""
    speed: float = 0.6
    """Commanded forward speed, m/s."""

    name: ClassVar[str] = "pictures"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 1 <= self.level <= LEVELS:
            raise RenetError(f"terrain level must be 1 to {LEVELS}, got {self.level}")
        if self.seconds < 2.0:
            raise RenetError(f"height maps need at least 2 seconds, got {self.seconds}")

    def run(self, evaluator: Evaluator | None = None) -> dict[str, Any]:
        """Draw all pictures; see `Study.run`. Nothing is kept in parts."""
        evaluator = evaluator or self.make_evaluator()
        out, kinds = output_folder(self.out), list(tiles())
        env = evaluator.make_env(PARKOUR, range(len(kinds)), self.speed, self.seed)
        origins = tile_terrain(env.env).terrain_origins
        rays = scanner(env.env.sim.mj_model, "cpu")
        torch.manual_seed(self.seed)
        provenance = evaluator.provenance(self.seed)
        drawn = {
            "tiles.png": draw_tiles(rays, origins),
            "camera.png": draw_camera(rays, origins),
        }
        env.place(np.full(len(kinds), self.level - 1), np.arange(len(kinds)))
        policy, trials = Policy(evaluator.bundle, len(kinds)), [Trial("vp") for _ in kinds]
        log, steps = MapLog(policy, env), round(self.seconds / CONTROL_DT)
        title = "height maps of all tiles"
        evaluator.rollout(title, env, trials, steps, self.seed, on_update=log.note, policy=policy)
        drawn["height_map.png"] = draw_height_maps(log.maps, kinds)
        for name, figure in drawn.items():
            figures.save(figure, out / name, provenance, dpi=80)
        summary = plain(
            {
                "study": self.name,
                "runs": errors(log.maps, kinds),
                "settings": asdict(self),
                "provenance": vars(provenance),
            }
        )
        write_json(out / "summary.json", summary)
        return summary

    def tables(self, summary: dict[str, Any]) -> list[Table]:
        """Errors of the height maps."""
        rows = [
            (
                row["terrain"],
                f"{100 * row['rmse_m']:.1f}",
                f"{100 * row['rmse_of_flat_ground_m']:.1f}",
            )
            for row in summary["runs"]
        ]
        header = ("terrain", "error (cm)", "of flat ground (cm)")
        return [("Height maps of the VP estimator", header, rows)]


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
    own = Intrinsics()
    width, height = own.width * SENSOR.fx / own.fx, own.height * SENSOR.fy / own.fy
    return (SENSOR.cx - width / 2, SENSOR.cy - height / 2), width, height


def _view(
    rays: TerrainScanner, eye: torch.Tensor, rotation: torch.Tensor, lens: Intrinsics | None = None
) -> torch.Tensor:
    """Planar depth [rows, columns] m, the range where nothing is hit."""
    lens = lens or Intrinsics()
    depth = rays.depth(eye[None], rotation, lens, DEPTH_RANGE)
    depth = depth.reshape(lens.height, lens.width)
    return torch.where(depth >= 0.0, depth, DEPTH_RANGE)
