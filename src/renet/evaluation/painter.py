"""Pictures without OpenGL: MuJoCo Warp's own ray tracer draws robots, on a CPU as on a GPU."""

from typing import NamedTuple

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp
from scipy.spatial.transform import Rotation

CAMERA = "renet_tracking_camera"
FOVY = 40.0
"""Vertical field of view, degrees."""
FOCAL = 0.5 / np.tan(np.radians(FOVY / 2))
"""Focal length in picture heights."""
PANEL = 400, 300
"""Width and height of a picture, pixels."""
LOW = 0.3
"""Metres above the ground under the robot at which the picture's middle is."""
AWAY = np.array([-1.1, -1.5, 0.75])
"""From the robot to the camera that follows it, m, in axes of the robot's initial heading."""
SUN = np.array([0.5, 0.35, -1.0])
"""Direction of the light."""
FLOOR, PIT = np.array([0.68, 0.69, 0.62]), 0.6
"""Colour of the ground, and the share of it that is lost 1 m below the start."""
SKY, HAZE = np.array([96, 150, 205]), np.array([222, 232, 236])
FOG = 4.0, 16.0
"""Metres from the camera at which haze begins, and over which it grows."""
ABOVE = 5.0
"""Metres above the start from which the ground's height is measured."""
SLAB, GRAIN = 0.5, 0.03
"""Sides of the ground's slabs and of its grains, m."""


class View(NamedTuple):
    """A picture and what lies in it."""

    picture: np.ndarray
    """[height, width, 3] uint8."""
    ground: np.ndarray
    """[height, width] bool: the pixel shows no robot."""
    eye: np.ndarray
    """The camera's place, [3] m."""
    axes: np.ndarray
    """Its axes in the world, as columns, [3, 3]."""

    def pixels(self, points: np.ndarray) -> np.ndarray:
        """Column, row and pixels for each metre there, of points [K, 3] m: [K, 3]."""
        height, width, _ = self.picture.shape
        x, y, z = ((points - self.eye) @ self.axes).T
        scale = FOCAL * height / np.maximum(-z, 0.05)
        return np.stack([width / 2 + scale * x, height / 2 - scale * y, scale], axis=1)


class Painter:
    """Ray-traces a few robots of one model, each from a camera that follows it."""

    def __init__(self, spec: mujoco.MjSpec, starts: np.ndarray) -> None:
        """Prepare a scene, which is copied, for robots that start at poses [R, nq]."""
        spec = spec.copy()
        spec.worldbody.add_camera(name=CAMERA, fovy=FOVY)
        self._model = model = spec.compile()
        self._ground = model.body_weldid[model.geom_bodyid] == 0
        """[geoms] bool: part of the ground."""
        _light(model, self._ground)
        self._host = mujoco.MjData(model)
        mujoco.mj_forward(model, self._host)
        self._camera = model.camera(CAMERA).id
        width, height = PANEL
        across, down = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
        focal = FOCAL * height
        rays = np.stack([across - width / 2, height / 2 - down, np.full_like(across, -focal)], -1)
        self._rays = rays / focal
        """What each pixel shows 1 m along the camera's axis, in its axes: [height, width, 3]."""
        turns = Rotation.from_quat(starts[:, 3:7], scalar_first=True)
        headings = Rotation.from_euler("z", turns.as_euler("ZYX")[:, :1])
        self._away = headings.apply(AWAY)
        """From each robot to its camera, [R, 3] m."""
        self._axes = np.stack([_axes(away) for away in self._away])
        """Axes of each camera, as columns, [R, 3, 3]."""
        # A robot without visual meshes shows what it collides with, MuJoCo's group 3.
        meshes = (model.geom_group[~self._ground] < 3).any()
        with wp.ScopedDevice("cpu"):
            self._warp_model = mjw.put_model(model)
            self._data = mjw.put_data(model, self._host, nworld=len(starts))
            self._context = mjw.create_render_context(
                model,
                nworld=len(starts),
                cam_res=PANEL,
                render_rgb=True,
                render_depth=True,
                render_seg=True,
                use_textures=False,
                use_shadows=True,
                enabled_geom_groups=[0, 1, 2] if meshes else [0, 1, 2, 3],
                cam_active=[i == self._camera for i in range(model.ncam)],
            )

    def draw(self, poses: np.ndarray) -> list[View]:
        """Pictures of robots with generalised positions [R, nq]."""
        data, context, shape = self._data, self._context, (len(poses), *reversed(PANEL))
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
            eye = ground + 0.3 * self._axes[i, :, 0] + [0, 0, LOW] + self._away[i]
            # It does not fall into a gap with its robot.
            eye[2] = max(eye[2], self.heights(eye[None])[0] + AWAY[2])
            cam_pos[i, self._camera] = eye
            cam_mat[i, self._camera] = self._axes[i]
        with wp.ScopedDevice("cpu"):
            mjw.refit_bvh(self._warp_model, data, context)
            mjw.render(self._warp_model, data, context)
        packed = context.rgb_data.numpy().reshape(shape)
        light = np.stack([packed >> 16 & 255, packed >> 8 & 255, packed & 255], -1).astype(float)
        depth = context.depth_data.numpy().reshape(shape)
        geom = context.seg_data.numpy().reshape(*shape, 2)[..., 0]
        eyes = cam_pos[:, self._camera].copy()
        cameras = zip(light, depth, geom, eyes, self._axes, strict=True)
        return [self._finish(*camera) for camera in cameras]

    def _finish(
        self,
        light: np.ndarray,
        depth: np.ndarray,
        geom: np.ndarray,
        eye: np.ndarray,
        axes: np.ndarray,
    ) -> View:
        """Give the ground slabs and haze; where no ray hit anything, a plain and a sky."""
        rays = self._rays @ axes.T
        up, missed = rays[..., 2], geom < 0
        plain = missed & (up < -1e-3)
        depth = np.where(plain, -eye[2] / np.minimum(up, -1e-3), depth)
        light = np.where(plain[..., None], 255 * FLOOR, light)
        ground = missed | self._ground[geom]
        seen = depth[..., None] * rays + [*eye[:2], AWAY[2] + LOW]
        shade = _texture(seen, np.exp(-depth / 3))
        haze = np.clip((depth - FOG[0]) / FOG[1], 0, 1)[..., None]
        floor = light * shade[..., None]
        steep = np.clip(up / np.linalg.norm(rays, axis=-1) / 0.35, 0, 1)[..., None]
        picture = np.where(ground[..., None], floor + haze * (HAZE - floor), light)
        picture = np.where((missed & ~plain)[..., None], HAZE + steep * (SKY - HAZE), picture)
        return View(picture.clip(0, 255).astype(np.uint8), ground, eye, axes)

    def heights(self, points: np.ndarray) -> np.ndarray:
        """Height of the ground under or over points [K, 3] m: [K], minus infinity for none."""
        down, ground = [0, 0, -1.0], np.array([1, 0, 0, 0, 0, 0], np.uint8)
        hit = ground, True, -1, np.zeros(1, np.int32)
        eyes = [[*point[:2], ABOVE] for point in points]
        falls = [mujoco.mj_ray(self._model, self._host, eye, down, *hit) for eye in eyes]
        return np.where(np.less(falls, 0), -np.inf, ABOVE - np.array(falls))


def _texture(points: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Brightness [...] of the ground at points [..., 3] m: slabs, grains, dark pits.

    `near`, [...], says how much the grains show.
    """
    x, y, z = np.moveaxis(points, -1, 0)
    slab, grain = (
        np.floor(x / side + 0.01) + 57 * np.floor(y / side + 0.01) for side in (SLAB, GRAIN)
    )
    grain = np.sin(78.233 * grain) * 43758.5453 % 1 - 0.5
    return (0.92 + 0.08 * (slab % 2) + 0.10 * near * grain) * np.clip(1 + PIT * z, 1 - PIT, 1)


def _light(model: mujoco.MjModel, ground: np.ndarray) -> None:
    """One slanting light, one colour of ground, and a robot that is not black; in place."""
    model.light_dir[:], model.light_active[1:] = SUN / np.linalg.norm(SUN), 0
    model.light_diffuse[:] = 0.75
    model.vis.headlight.active, model.vis.headlight.ambient[:] = 1, 0.38
    model.geom_rgba[ground, :3], model.geom_matid[ground] = FLOOR, -1
    model.mat_rgba[:, :3] = 0.3 + 0.7 * model.mat_rgba[:, :3]


def _axes(away: np.ndarray) -> np.ndarray:
    """Axes, as columns [3, 3], of a camera that looks back along `away`, [3]."""
    back = away / np.linalg.norm(away)
    right = np.cross([0, 0, 1], back)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(back, right), back], axis=1)
