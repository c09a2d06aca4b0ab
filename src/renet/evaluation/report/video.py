"""Videos without OpenGL: MuJoCo Warp's own ray tracer draws the robots, on a CPU as on a GPU."""

from collections.abc import Iterator, Mapping
from pathlib import Path

import mediapy
import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp
from PIL import Image, ImageDraw, ImageFont

from renet.errors import RenetError
from renet.evaluation.trace import Trace
from renet.files import write_atomically
from renet.interface import CONTROL_DT, STEPS_PER_TICK
from renet.palette import STATES, rgb
from renet.terminal import progress

CAMERA = "renet_tracking_camera"
AWAY = np.array([1.6 * np.cos(np.radians(-110.0)), 1.6 * np.sin(np.radians(-110.0)), 0.55])
"""From the robot to the camera that follows it, m, in axes of the robot's initial heading."""
BACK = AWAY / np.linalg.norm(AWAY)
RIGHT = np.cross([0, 0, 1], BACK) / np.linalg.norm(np.cross([0, 0, 1], BACK))
ROTATION = np.stack([RIGHT, np.cross(BACK, RIGHT), BACK], axis=1)
"""The camera's axes."""
_font = ImageFont.load_default
"""Pillow's own font: the same everywhere, nothing to install."""
PANEL = 320, 240
"""Width and height of one robot's panel, pixels."""
GREEN, RED, WHITE = (126, 200, 120), (235, 92, 80), (245, 245, 245)
SHADE = (16, 18, 22, 190)
"""Behind texts."""


def _shade_ground(model: mujoco.MjModel) -> None:
    """Make the edges of untextured ground visible, in place: muted browns, and no third light."""
    ground = (model.body_weldid[model.geom_bodyid] == 0) & (model.geom_matid < 0)
    shades = np.array([0.26, 0.34, 0.30])[np.arange(model.ngeom) % 3]
    model.geom_rgba[ground, :3] = shades[ground, None] * [1.3, 1.15, 0.95]
    model.light_diffuse[:] *= min(1.0, 2 / max(model.nlight, 1))


class Painter:
    """Ray-traces a few robots of one model, each from a camera that follows it."""

    def __init__(self, spec: mujoco.MjSpec, num_robots: int) -> None:
        """Prepare a scene, which is copied, for `num_robots` images at a time."""
        spec = spec.copy()
        spec.worldbody.add_camera(name=CAMERA, fovy=38)
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
                cam_res=PANEL,
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
            # The camera keeps its height, or a trotting robot would seem to stand on moving ground.
            # Rounding to a grid of 0.1 m does that on even ground.
            ground = np.array([*pose[:2], round(pose[2] - 0.3, 1)])
            # Left and low in the picture: the depth image is shown in the upper right corner.
            cam_pos[i, self._camera] = ground + 0.15 * RIGHT + [0, 0, 0.26] + AWAY
            cam_mat[i, self._camera] = ROTATION
        with wp.ScopedDevice("cpu"):
            mjw.refit_bvh(self._warp_model, data, self._context)
            mjw.render(self._warp_model, data, self._context)
        packed = self._context.rgb_data.numpy().reshape(len(poses), *reversed(PANEL))
        return np.stack([packed >> 16 & 255, packed >> 8 & 255, packed & 255], -1).astype(np.uint8)


def film(
    path: Path,
    spec: mujoco.MjSpec,
    trace: Trace,
    titles: Mapping[int, str],
    fault: str,
    fps: int = 25,
) -> Path:
    """Draw robots side by side and write an mp4 that any browser plays, beside a progress bar.

    A robot that fell is put back at its start by the simulator: its picture stops instead.

    Args:
        path: of the mp4; raises RenetError if ffmpeg is missing, or it cannot be written.
        spec: the scene. trace: a run whose robots are all on its film.
        titles: what to call the robots that are shown, by their places in the trace.
        fault: what to call a failing camera. fps: a divisor of the control rate.
    """
    filmed, fallen, robots = trace.film, trace.fallen, list(titles)
    assert filmed is not None
    painter = Painter(spec, len(robots))
    last_upright = np.maximum((~fallen).sum(axis=0) - 1, 0)[robots]

    def pictures() -> Iterator[np.ndarray]:
        for step in progress(range(0, len(fallen), round(1 / (fps * CONTROL_DT))), "video"):
            drawn = painter.draw(filmed.poses[np.minimum(step, last_upright), robots])
            panels = zip(drawn, titles.items(), strict=True)
            yield np.hstack([_stamp(one, trace, step, *titled, fault) for one, titled in panels])

    try:
        video = mediapy.compress_video(pictures(), fps=fps, crf=26)
    except RuntimeError as error:
        raise RenetError(f"cannot write {path}: {str(error).splitlines()[0]}") from error
    write_atomically(path, video)
    return path


def _stamp(
    picture: np.ndarray, trace: Trace, step: int, robot: int, title: str, fault: str
) -> np.ndarray:
    """The picture [height, width, 3] with texts and the depth image that the robot gets."""
    fallen, failing = trace.fallen[step, robot], trace.failing[step, robot]
    image = Image.fromarray(picture)
    draw = ImageDraw.Draw(image, "RGBA")
    width, height = image.size
    draw.rectangle((0, 0, width, 24), fill=SHADE)
    draw.text((8, 4), title, font=_font(14), fill=WHITE)
    state = "sees" if trace.has_image[step, robot] else "remembers"
    state = state if trace.vision[step, robot] else "blind"
    colour = rgb(STATES[state][0])
    draw.rectangle((width - 88, 0, width, 24), fill=colour)
    draw.text((width - 8, 4), state, font=_font(14), fill=WHITE, anchor="ra")
    depth = Image.fromarray(trace.film.images[step // STEPS_PER_TICK, robot])
    draw.rectangle((width - 106, 32, width - 7, 107), fill=colour)
    image.paste(depth.resize((96, 72), Image.Resampling.NEAREST), (width - 104, 34))
    draw.rectangle((0, height - 22, width, height), fill=SHADE)
    pace = "fallen" if fallen else f"{trace.speed[step, robot]:+.2f} m/s"
    draw.text((8, height - 19), pace, font=_font(13), fill=RED if fallen else WHITE)
    words, colour = (fault, RED) if failing else ("camera healthy", GREEN)
    draw.text((width - 8, height - 19), words, font=_font(13), fill=colour, anchor="ra")
    return np.asarray(image)
