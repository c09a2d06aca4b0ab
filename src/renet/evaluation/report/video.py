"""Videos without OpenGL: MuJoCo Warp's own ray tracer draws the robots, on a CPU as on a GPU."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import mediapy
import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp
from matplotlib import colormaps
from PIL import Image, ImageDraw, ImageFont

from renet.errors import RenetError
from renet.evaluation.trace import Trace
from renet.files import write_atomically
from renet.interface import CONTROL_DT, HEIGHT_MAP_X, HEIGHT_MAP_Y, STEPS_PER_TICK
from renet.palette import STATES, rgb
from renet.terminal import progress

CAMERA = "renet_tracking_camera"
AWAY = np.array([1.6 * np.cos(np.radians(-110.0)), 1.6 * np.sin(np.radians(-110.0)), 0.55])
"""From the robot to the camera that follows it, m, in axes of the robot's initial heading."""
GREEN, RED, WHITE = (126, 200, 120), (235, 92, 80), (245, 245, 245)
RELIEF = 0.5
"""Metres of ground above or below the robot's own that end a height map's colours."""


@dataclass(frozen=True)
class VideoCfg:
    """How a video looks."""

    width: int = 320
    """Pixels of one robot's panel."""
    height: int = 240
    """Pixels of one robot's panel."""
    fps: int = 25
    """Frames per second, a divisor of the control rate (50)."""


def _shade_ground(model: mujoco.MjModel) -> None:
    """Make the edges of untextured ground visible, in place: muted browns, and no third light."""
    ground = (model.body_weldid[model.geom_bodyid] == 0) & (model.geom_matid < 0)
    shades = np.array([0.26, 0.34, 0.30])[np.arange(model.ngeom) % 3]
    model.geom_rgba[ground, :3] = shades[ground, None] * [1.3, 1.15, 0.95]
    model.light_diffuse[:] *= min(1.0, 2 / max(model.nlight, 1))


class Painter:
    """Ray-traces a few robots of one model, each from a camera that follows it."""

    def __init__(self, spec: mujoco.MjSpec, num_robots: int, cfg: VideoCfg) -> None:
        """Prepare a scene, which is copied, for `num_robots` images at a time."""
        spec = spec.copy()
        spec.worldbody.add_camera(name=CAMERA, fovy=38)
        self._cfg = cfg
        self._model = spec.compile()
        _shade_ground(self._model)
        self._host = mujoco.MjData(self._model)
        mujoco.mj_forward(self._model, self._host)
        self._camera = self._model.camera(CAMERA).id
        with wp.ScopedDevice("cpu"):
            self._warp_model = mjw.put_model(self._model)
            self._data = mjw.put_data(self._model, self._host, nworld=num_robots)
            self._context = mjw.create_render_context(
                self._model,
                nworld=num_robots,
                cam_res=(cfg.width, cfg.height),
                render_rgb=True,
                render_depth=False,
                use_shadows=True,
                enabled_geom_groups=[0, 1, 2],
                cam_active=[i == self._camera for i in range(self._model.ncam)],
                render_skybox=True,
            )

    def draw(self, poses: np.ndarray) -> np.ndarray:
        """Images [R, height, width, 3] uint8 of the generalised positions [R, nq]."""
        data = self._data
        placed = ("geom_xpos", "geom_xmat", "light_xpos", "light_xdir")
        views = {name: getattr(data, name).numpy() for name in placed}
        cam_pos, cam_mat = data.cam_xpos.numpy(), data.cam_xmat.numpy()
        for i, pose in enumerate(poses):
            self._host.qpos[:] = pose
            mujoco.mj_kinematics(self._model, self._host)
            mujoco.mj_camlight(self._model, self._host)
            for name, view in views.items():
                view[i] = getattr(self._host, name).reshape(view[i].shape)
            cam_pos[i, self._camera], cam_mat[i, self._camera] = self._viewpoint(pose[:3])
        with wp.ScopedDevice("cpu"):
            mjw.refit_bvh(self._warp_model, data, self._context)
            mjw.render(self._warp_model, data, self._context)
        packed = self._context.rgb_data.numpy()
        packed = packed.reshape(len(poses), self._cfg.height, self._cfg.width)
        return np.stack([packed >> 16 & 255, packed >> 8 & 255, packed & 255], -1).astype(np.uint8)

    def _viewpoint(self, robot: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Position and rotation matrix of a camera that looks at a robot's position [3]."""
        # The camera keeps its height, or a trotting robot would seem to stand on moving ground.
        # Rounding to a grid of 0.1 m does that on even ground.
        ground = np.array([robot[0], robot[1], round(robot[2] - 0.3, 1)])
        back = AWAY / np.linalg.norm(AWAY)
        right = np.cross([0, 0, 1], back)
        right /= np.linalg.norm(right)
        # Left and low in the picture: the depth image is shown in the upper right corner.
        target = ground + 0.15 * right + [0, 0, 0.26]
        return target + AWAY, np.stack([right, np.cross(back, right), back], axis=1)


@dataclass(frozen=True)
class Panel:
    """What is written over one robot's picture, at each of F video frames."""

    title: str
    depth: np.ndarray
    """[F, 48, 64] uint8, the depth image the robot gets."""
    vision: np.ndarray
    """[F] bool, VP in charge."""
    has_image: np.ndarray
    """[F] bool, VP gets its images; without, it goes on from memory."""
    fallen: np.ndarray
    """[F] bool"""
    fault: Sequence[str]
    """[F] what is wrong with the camera; empty where nothing is."""
    speed: np.ndarray
    """[F] m/s"""
    maps: np.ndarray | None = None
    """[F, 2, 132] m, the VP estimator's height map and the terrain's."""

    def stamp(self, picture: np.ndarray, frame: int) -> np.ndarray:
        """The picture [height, width, 3] with the panel's texts and depth inset."""
        image = Image.fromarray(picture)
        draw = ImageDraw.Draw(image, "RGBA")
        width, height = image.size
        draw.rectangle((0, 0, width, 24), fill=(16, 18, 22, 190))
        draw.text((8, 4), self.title, font=_font(14), fill=WHITE)
        state = "sees" if self.has_image[frame] else "remembers"
        state = state if self.vision[frame] else "blind"
        chip = (state, rgb(STATES[state][0]))
        draw.rectangle((width - 88, 0, width, 24), fill=chip[1])
        draw.text((width - 8, 4), chip[0], font=_font(14), fill=WHITE, anchor="ra")
        inset = Image.fromarray(self.depth[frame]).resize((96, 72), Image.Resampling.NEAREST)
        corner = (width - 104, 34)
        draw.rectangle((corner[0] - 2, 32, corner[0] + 97, 107), fill=chip[1])
        image.paste(inset.convert("RGB"), corner)
        if self.maps is not None:
            predicted, true = (map_picture(values, scale=4) for values in self.maps[frame])
            draw.rectangle((width - 106, 110, width - 7, 174), fill=(16, 18, 22, 190))
            image.paste(Image.fromarray(beside(predicted, true)), (width - 102, 112))
            for x, label in ((width - 102, "predicted"), (width - 54, "ground")):
                draw.text((x, 161), label, font=_font(10), fill=WHITE)
        pace = "fallen" if self.fallen[frame] else f"{self.speed[frame]:+.2f} m/s"
        draw.rectangle((0, height - 22, width, height), fill=(16, 18, 22, 190))
        colour = RED if self.fallen[frame] else WHITE
        draw.text((8, height - 19), pace, font=_font(13), fill=colour)
        fault = self.fault[frame] or "camera healthy"
        colour = RED if self.fault[frame] else GREEN
        draw.text((width - 8, height - 19), fault, font=_font(13), fill=colour, anchor="ra")
        return np.asarray(image)


def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """Pillow's own font: the same everywhere, nothing to install."""
    return ImageFont.load_default(size)


def map_picture(height_map: np.ndarray, scale: int = 16) -> np.ndarray:
    """Colours [12 scale, 11 scale, 3] uint8 of a height map [132] m; high ground is bright."""
    shares = 0.5 + as_seen(height_map) / (2 * RELIEF)
    return colormaps["viridis"](shares, bytes=True)[..., :3].repeat(scale, 0).repeat(scale, 1)


def as_seen(height_map: np.ndarray) -> np.ndarray:
    """Heights of the ground [12, 11] m of a height map [132], from above: ahead is up.

    A height map is the robot's height over the ground: its negative is the ground's.
    """
    return -height_map.reshape(len(HEIGHT_MAP_X), len(HEIGHT_MAP_Y))[::-1, ::-1]


def beside(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Two pictures of one height side by side, with a white line between."""
    return np.concatenate((left, np.full((len(left), 4, 3), 255, np.uint8), right), axis=1)


def film(
    path: Path,
    spec: mujoco.MjSpec,
    trace: Trace,
    titles: Mapping[int, str],
    fault: str,
    cfg: VideoCfg,
    maps: np.ndarray | None = None,
) -> Path:
    """Film some rows of a trace, whose rows are all on its film; see `make_video`.

    A robot that fell is put back at its start by the simulator: its picture stops instead.

    Args:
        path: of the mp4.
        spec: the scene.
        trace: with its film.
        titles: by row.
        fault: what to call a failing camera.
        cfg: look.
        maps: [T, N, 2, 132] m, see `keep_maps`.
    """
    filmed, fallen = trace.film, trace.fallen
    assert filmed is not None
    frames = np.arange(0, len(fallen), round(1 / (cfg.fps * CONTROL_DT)))
    panels = [
        Panel(
            title=title,
            depth=filmed.images[frames // STEPS_PER_TICK, row],
            vision=trace.vision[frames, row],
            has_image=trace.has_image[frames, row],
            fallen=fallen[frames, row],
            fault=[fault if failing else "" for failing in trace.failing[frames, row]],
            speed=trace.speed[frames, row],
            maps=None if maps is None else maps[frames, row],
        )
        for row, title in titles.items()
    ]
    upright = np.maximum((~fallen).sum(axis=0) - 1, 0)
    poses = [filmed.poses[np.minimum(frames, upright[row]), row] for row in titles]
    return make_video(path, spec, np.stack(poses, axis=1), panels, cfg)


def make_video(
    path: Path, spec: mujoco.MjSpec, poses: np.ndarray, panels: Sequence[Panel], cfg: VideoCfg
) -> Path:
    """Draw robots side by side and write an mp4 that any browser plays, beside a progress bar.

    Args:
        path: of the mp4.
        spec: scene the poses belong to.
        poses: [F, R, nq].
        panels: one for each robot.
        cfg: look.

    Raises:
        RenetError: ffmpeg is missing, or the file cannot be written.
    """
    painter = Painter(spec, len(panels), cfg)

    def pictures() -> Iterator[np.ndarray]:
        for frame, pose in enumerate(progress(poses, "video")):
            drawn = zip(panels, painter.draw(pose), strict=True)
            yield np.concatenate([panel.stamp(one, frame) for panel, one in drawn], axis=1)

    try:
        video = mediapy.compress_video(pictures(), fps=cfg.fps, crf=26)
    except RuntimeError as error:
        raise RenetError(f"cannot write {path}: {str(error).splitlines()[0]}") from error
    write_atomically(path, video)
    return path
