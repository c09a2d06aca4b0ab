"""Pictures of robots without OpenGL, by MuJoCo Warp's ray tracer, on a CPU or a GPU."""

import warnings
from itertools import starmap
from typing import NamedTuple

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp
from scipy.spatial.transform import Rotation

_CAMERA = "renet_tracking_camera"
"""Name of the camera that is added to the scene."""
_FOVY = 40.0
"""Vertical field of view, degrees."""
_FOCAL = 0.5 / np.tan(np.radians(_FOVY / 2))
"""Focal length in units of the picture's height."""
PANEL = (400, 300)
"""Width and height of a picture, pixels."""
_TARGET_HEIGHT = 0.3
"""Height of the picture's centre above the ground under the robot, m."""
_CAMERA_OFFSET = np.array([-1.1, -1.5, 0.75])
"""Vector from the robot to the camera that follows it, m, in the frame of its initial heading."""
_SUN = np.array([0.5, 0.35, -1.0])
"""Direction of the light."""
_FLOOR = np.array([0.68, 0.69, 0.62])
"""Colour of the ground, 0 to 1."""
_PIT_SHADE = 0.6
"""Share of the ground's brightness that is lost 1 m below the start."""
_SKY = np.array([96, 150, 205])
"""Colour of the sky, 0 to 255."""
_HAZE = np.array([222, 232, 236])
"""Colour of the horizon and of distant ground, 0 to 255."""
_FOG = (4.0, 16.0)
"""Distance from the camera at which haze begins, and distance over which it grows, m."""
_PROBE_HEIGHT = 5.0
"""Height above the start from which rays measure the ground, m."""
_SLAB = 0.5
"""Side of the ground's slabs, m."""
_GRAIN = 0.03
"""Side of the ground's grains, m."""


class View(NamedTuple):
    """A picture with its camera."""

    picture: np.ndarray
    """Colours, [height, width, 3] uint8."""
    ground: np.ndarray
    """True where a pixel shows no robot, [height, width] bool."""
    eye: np.ndarray
    """Position of the camera, [3] m."""
    axes: np.ndarray
    """Axes of the camera in the world, as columns, [3, 3]."""

    def pixels(self, points: np.ndarray) -> np.ndarray:
        """Project points [K, 3] m; returns column, row and scale in pixels per metre, [K, 3]."""
        height, width, _ = self.picture.shape
        x, y, z = ((points - self.eye) @ self.axes).T
        scale = _FOCAL * height / np.maximum(-z, 0.05)
        return np.stack([width / 2 + scale * x, height / 2 - scale * y, scale], axis=1)


class Painter:
    """Ray tracer of a few robots of one model, each seen from a camera that follows it."""

    def __init__(self, spec: mujoco.MjSpec, starts: np.ndarray) -> None:
        """Prepare a scene, which is copied, for robots that start at poses [R, nq]."""
        spec = spec.copy()
        spec.worldbody.add_camera(name=_CAMERA, fovy=_FOVY)
        model = spec.compile()
        self._model = model
        self._ground = model.body_weldid[model.geom_bodyid] == 0
        """True for geoms that are part of the ground, [geoms] bool."""
        _light(model, self._ground)
        self._host = mujoco.MjData(model)
        mujoco.mj_forward(model, self._host)
        self._camera = model.camera(_CAMERA).id
        self._rays = _pixel_rays()
        turns = Rotation.from_quat(starts[:, 3:7], scalar_first=True)
        headings = Rotation.from_euler("z", turns.as_euler("ZYX")[:, :1])
        self._away = headings.apply(_CAMERA_OFFSET)
        """Vector from each robot to its camera, [R, 3] m."""
        self._axes = np.stack(list(map(_axes, self._away)))
        """Axes of each camera, as columns, [R, 3, 3]."""
        # A robot without visual meshes is drawn by its collision geoms, MuJoCo's group 3.
        meshes = (model.geom_group[~self._ground] < 3).any()
        # MuJoCo Warp warns of contacts with height fields, of which pictures have none.
        with wp.ScopedDevice("cpu"), warnings.catch_warnings(action="ignore"):
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
                cam_active=(np.arange(model.ncam) == self._camera).tolist(),
            )

    def draw(self, poses: np.ndarray) -> list[View]:
        """Draw robots with generalised positions [R, nq]; one view for each."""
        data = self._data
        context = self._context
        shape = (len(poses), *reversed(PANEL))
        eyes = self._place(poses)
        with wp.ScopedDevice("cpu"):
            mjw.refit_bvh(self._warp_model, data, context)
            mjw.render(self._warp_model, data, context)
        # Colours are packed: red in bits 16 to 23, then green and blue.
        packed = context.rgb_data.numpy().reshape(shape)
        light = np.stack([packed >> 16 & 255, packed >> 8 & 255, packed & 255], -1).astype(float)
        depth = context.depth_data.numpy().reshape(shape)
        geom = context.seg_data.numpy().reshape(*shape, 2)[..., 0]
        cameras = zip(light, depth, geom, eyes, self._axes, strict=True)
        return list(starmap(self._finish, cameras))

    def _place(self, poses: np.ndarray) -> np.ndarray:
        """Put robots [R, nq] and their cameras into the renderer's data; returns eyes, [R, 3] m."""
        # These arrays share the memory of the renderer's data.
        names = ("geom_xpos", "geom_xmat", "light_xpos", "light_xdir")
        views = {name: getattr(self._data, name).numpy() for name in names}
        cam_pos = self._data.cam_xpos.numpy()
        cam_mat = self._data.cam_xmat.numpy()
        for i, pose in enumerate(poses):
            self._host.qpos[:] = pose
            mujoco.mj_kinematics(self._model, self._host)
            mujoco.mj_camlight(self._model, self._host)
            for name, view in views.items():
                view[i] = getattr(self._host, name).reshape(view[i].shape)
            # The camera keeps its height, or a trotting robot would seem to stand on moving ground.
            # Rounding to a grid of 0.1 m does that on even ground.
            ground = np.array([*pose[:2], round(pose[2] - 0.3, 1)])
            # Left and low in the picture, for the depth image is in the upper right corner.
            eye = ground + 0.3 * self._axes[i, :, 0] + [0, 0, _TARGET_HEIGHT] + self._away[i]
            # It does not fall into a gap with its robot.
            eye[2] = max(eye[2], self.heights(eye[None])[0] + _CAMERA_OFFSET[2])
            cam_pos[i, self._camera] = eye
            cam_mat[i, self._camera] = self._axes[i]
        return cam_pos[:, self._camera].copy()

    def _finish(
        self,
        light: np.ndarray,
        depth: np.ndarray,
        geom: np.ndarray,
        eye: np.ndarray,
        axes: np.ndarray,
    ) -> View:
        """Add slabs and haze to the ground, and a plain and a sky where no ray hit anything.

        Args:
            light: Traced colours, [height, width, 3], 0 to 255.
            depth: Distance along the camera's axis, [height, width] m.
            geom: Geom of each pixel, [height, width]; negative for none.
            eye: Position of the camera, [3] m.
            axes: Its axes, as columns, [3, 3].
        """
        rays = self._rays @ axes.T
        up = rays[..., 2]
        missed = geom < 0
        # Rays below the horizon that miss hit a plain at the start's height.
        plain = missed & (up < -1e-3)
        depth = np.where(plain, -eye[2] / np.minimum(up, -1e-3), depth)
        light = np.where(plain[..., None], 255 * _FLOOR, light)
        ground = missed | self._ground[geom]
        # Texture and haze of the ground.
        points = depth[..., None] * rays + [*eye[:2], _CAMERA_OFFSET[2] + _TARGET_HEIGHT]
        shade = _texture(points, np.exp(-depth / 3))
        haze = np.clip((depth - _FOG[0]) / _FOG[1], 0, 1)[..., None]
        floor = light * shade[..., None]
        # The sky is bluer the steeper a ray goes up.
        steep = np.clip(up / np.linalg.norm(rays, axis=-1) / 0.35, 0, 1)[..., None]
        picture = np.where(ground[..., None], floor + haze * (_HAZE - floor), light)
        picture = np.where((missed & ~plain)[..., None], _HAZE + steep * (_SKY - _HAZE), picture)
        return View(picture.clip(0, 255).astype(np.uint8), ground, eye, axes)

    def heights(self, points: np.ndarray) -> np.ndarray:
        """Return the ground's height at points [K, 3] m: [K] m, minus infinity for none."""
        down = [0, 0, -1.0]
        # MuJoCo's group 0, static geoms included, no body excluded.
        groups = np.array([1, 0, 0, 0, 0, 0], np.uint8)
        geom = np.zeros(1, np.int32)
        distances = []
        for point in points:
            eye = [*point[:2], _PROBE_HEIGHT]
            ray = mujoco.mj_ray(self._model, self._host, eye, down, groups, True, -1, geom)
            distances.append(ray)
        return np.where(np.less(distances, 0), -np.inf, _PROBE_HEIGHT - np.array(distances))


def _pixel_rays() -> np.ndarray:
    """Return each pixel's ray, 1 m along the camera's axis, in its frame, [height, width, 3]."""
    width, height = PANEL
    across, down = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    focal = _FOCAL * height
    rays = np.stack([across - width / 2, height / 2 - down, np.full_like(across, -focal)], -1)
    return rays / focal


def _texture(points: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Return the brightness [...] of the ground at points [..., 3] m: slabs, grains and dark pits.

    `near`, [...], is the contrast of the grains, 0 to 1.
    """
    x, y, z = np.moveaxis(points, -1, 0)
    slab = _cell_number(x, y, _SLAB)
    # A pseudo-random number for each cell, -0.5 to 0.5.
    grain = np.sin(78.233 * _cell_number(x, y, _GRAIN)) * 43758.5453 % 1 - 0.5
    pit = np.clip(1 + _PIT_SHADE * z, 1 - _PIT_SHADE, 1)
    return (0.92 + 0.08 * (slab % 2) + 0.10 * near * grain) * pit


def _cell_number(x: np.ndarray, y: np.ndarray, side: float) -> np.ndarray:
    """Return the number [...] of the square cell of a grid at positions x and y, [...] m."""
    return np.floor(x / side + 0.01) + 57 * np.floor(y / side + 0.01)


def _light(model: mujoco.MjModel, ground: np.ndarray) -> None:
    """Set one slanting light, one colour of ground and a lighter robot, in place."""
    model.light_dir[:] = _SUN / np.linalg.norm(_SUN)
    model.light_active[1:] = 0
    model.light_diffuse[:] = 0.75
    model.vis.headlight.active = 1
    model.vis.headlight.ambient[:] = 0.38
    model.geom_rgba[ground, :3] = _FLOOR
    model.geom_matid[ground] = -1
    # Black parts of a robot would hide its shape.
    model.mat_rgba[:, :3] = 0.3 + 0.7 * model.mat_rgba[:, :3]


def _axes(away: np.ndarray) -> np.ndarray:
    """Return the axes, as columns [3, 3], of a camera that looks back along `away`, [3]."""
    back = away / np.linalg.norm(away)
    right = np.cross([0, 0, 1], back)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(back, right), back], axis=1)
