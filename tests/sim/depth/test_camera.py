"""Depth and terrain scans against closed-form scenes, MuJoCo's own rays and stated statistics."""

import math
from itertools import pairwise
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
import torch
from mjlab.utils.lab_api.math import matrix_from_quat
from scipy.spatial.transform import Rotation
from tests.sim.scenes import PLANE, ROBOT, make, scene

from renet.camera import Intrinsics
from renet.errors import RenetError
from renet.sim.depth.camera import (
    DepthCamera,
    DepthCameraCfg,
    DepthNoiseCfg,
    MountCfg,
    add_noise,
    mount_rotation,
)
from renet.sim.depth.terrain_mesh import terrain_shapes
from renet.sim.sensors import FeetHeightCfg

QUIET = DepthNoiseCfg(relative_std=0.0, gaussian_std=0.0)
EXACT = MountCfg(position=(0.0, 0.0, 0.0), pitch=0.0, position_error=0.0, angle_error=0.0)
FLAT = scene(PLANE, ROBOT)


def camera(model: mujoco.MjModel = FLAT, robots: int = 1, **fields) -> DepthCamera:
    """The sensor on robots that all are where the scene has theirs, 0.5 m above the origin."""
    fields = {"noise": QUIET, "mount": EXACT, **fields}
    sensor = DepthCameraCfg(name="depth", body="robot", **fields).build()
    xpos, xmat = torch.tensor([0.0, 0.0, 0.5]).repeat(robots, 2, 1), torch.eye(3)
    state = {"xmat": xmat.expand(robots, 2, 3, 3), "qpos": torch.zeros(robots, 7)}
    sensor.initialize(model, None, SimpleNamespace(xpos=xpos, **state), "cpu")
    return sensor


def test_wall_has_one_planar_depth():
    image = camera(scene('<geom type="box" size="0.1 0.3 5" pos="1.1 0 0"/>', ROBOT)).data
    seen = np.abs(Intrinsics().axes()[0]) < 0.3
    expected = np.where(seen, 1.0, 2.0)[None].repeat(48, 0)
    np.testing.assert_allclose(image[0], expected, atol=1e-3)
    # The top row comes first, and left is left.
    image = camera(scene('<geom type="box" size="0.1 0.2 0.2" pos="1.1 0.3 0.8"/>', ROBOT)).data
    assert (np.argwhere(image[0].numpy() < 2.0).max(axis=0) < (24, 32)).all()


def test_mount_yaws_then_pitches():
    pitch, yaw = torch.linspace(-1.0, 1.6, 9), torch.linspace(2.0, -2.0, 9)
    expected = Rotation.from_euler("ZY", torch.stack((yaw, pitch), -1)).as_matrix()
    expected = torch.from_numpy(expected).float()
    torch.testing.assert_close(mount_rotation(pitch, yaw), expected, atol=1e-6, rtol=0)


def test_mount_errors_change_with_episodes():
    sensor = camera(robots=500, mount=MountCfg())
    offset = sensor._position - torch.tensor(MountCfg().position)
    assert 0.009 < offset.abs().max() <= 0.01
    x, y, z = sensor._rotation[:, :, 0].unbind(-1)
    for angle in (-torch.asin(z) - math.radians(30.0), torch.atan2(y, x)):
        assert 4.5 < torch.rad2deg(angle).abs().max() <= 5.001
    before = sensor._position.clone()
    sensor.reset(torch.tensor([3]))
    changed = (before != sensor._position).any(-1)
    assert changed.nonzero().flatten().tolist() == [3]


def test_noise_has_the_stated_statistics():
    torch.manual_seed(0)
    depth = torch.full((400, 500), 1.5)
    error = add_noise(depth, DepthNoiseCfg()) - depth
    assert error.mean().abs() < 1e-3
    assert error.var() == pytest.approx(0.01 + 0.015**2, rel=0.02)
    assert torch.equal(add_noise(depth, QUIET), depth)
    shown = camera(noise=DepthNoiseCfg()).normalised()
    assert 0.0 <= shown.min() <= shown.max() <= 1.0


class Walk:
    """Robots at x = 0.1 m per control step, on each their own line, in front of a wall at 2 m."""

    def __init__(self, robots: int, delay: tuple[float, float]) -> None:
        wall = scene('<geom type="box" size="0.1 9 9" pos="2.1 0 0"/>', ROBOT)
        self.camera, self.step = camera(wall, robots, range=9.0, delay=delay), 0
        self.xpos = self.camera._data.xpos

    def take(self, steps: int, dt: float = 0.02) -> torch.Tensor:
        """Walk on; m from where each robot's image was taken to the wall, in its middle."""
        for _ in range(steps):
            self.step += 1
            self.xpos[..., 0] += 0.1 * dt / 0.02
            self.camera.update(dt)
        return self.camera.data[:, 24, 32]


@pytest.mark.parametrize("late", [0, 1, 3, 5, 7])
@pytest.mark.parametrize("dt", [0.02, 0.005])  # Whether time passes by control or physics steps.
def test_late_image_shows_earlier_view(late, dt):
    walk = Walk(1, (0.02 * late, 0.02 * late))
    for _ in range(2):
        got = walk.take(5 * round(0.02 / dt), dt)  # At last the image of step 10.
    assert got.item() == pytest.approx(2.0 - 0.1 * (10 - late), abs=1e-4)


def test_delay_stays_within_the_episode():
    walk = Walk(2, (0.1, 0.1))
    walk.take(8)
    walk.xpos[1, :, 0] = -3.0
    walk.camera.reset(torch.tensor([1]))
    of_robot_0, of_robot_1 = walk.take(2)
    assert of_robot_0 == pytest.approx(2.0 - 0.5, abs=1e-4)
    # Two steps into the new episode: the first of them is all there is to show.
    assert of_robot_1 == pytest.approx(2.0 - (-3.0 + 0.1), abs=1e-4)


def test_delays_are_whole_control_steps():
    walk = Walk(400, (0.0, 0.1))
    for _ in range(2):
        walk.take(5)
        steps = ((walk.take(5) - 2.0) / 0.1 + walk.step).round().int()
        assert steps.unique().tolist() == [0, 1, 2, 3, 4, 5]
        before = walk.camera._delay.clone()
        walk.xpos[..., 0], walk.step = 0.0, 0
        walk.camera.reset()
        assert (before != walk.camera._delay).any()
        assert walk.take(0).tolist() == pytest.approx([2.0] * 400, abs=1e-4), "it has no past"


def ticks(sensor: DepthCamera, steps: int) -> list[int]:
    """Control steps of 0.02 s after which there is another image."""
    images = [sensor.data]
    for _ in range(steps):
        sensor.update(0.02)
        images.append(sensor.data)
    return [step for step, (a, b) in enumerate(pairwise(images), 1) if a is not b]


def test_reset_between_steps_restarts_clock():
    sensor = camera()
    assert ticks(sensor, 13) == [5, 10]
    sensor.update(0.02)
    old = sensor._image
    sensor.reset(torch.tensor([0]))  # The only robot falls in step 14 ...
    assert sensor.data is old
    assert ticks(sensor, 8) == [1, 6]  # ... and consumers still tick at steps 15 and 20.
    sensor.reset()
    assert ticks(sensor, 11) == [5, 10]
    assert ticks(camera(period=0.05), 10) == [3, 5, 8, 10], "no multiple of the step"


def test_any_mjlab_task_can_carry_the_camera():
    def carry(cfg) -> None:
        cfg.scene.sensors += (DepthCameraCfg(name="depth", noise=QUIET),)

    env = make("Mjlab-Velocity-Flat-Unitree-Go1", carry, "auto")
    sensor, data = env.scene["depth"], env.sim.data
    shown, changed = sensor.normalised(), []
    directions = torch.from_numpy(Intrinsics().rays(np.float32))
    assert shown.shape == (3, 48, 64)
    for step in range(1, 12):
        env.step(torch.zeros(3, 12))
        if sensor.normalised() is not shown:
            shown = sensor.normalised()
            changed.append(step)
            # The image is of now: flat ground straight below the principal point, closed form.
            base = matrix_from_quat(data.xquat[:, sensor._body])
            eye = data.xpos[:, sensor._body] + (base @ sensor._position[..., None])[..., 0]
            expected = -eye[:, 2, None] / ((base @ sensor._rotation) @ directions.T)[:, 2]
            expected = torch.where((expected > 0) & (expected < 2), expected, 2.0)
            torch.testing.assert_close(sensor.data.flatten(1), expected, atol=1e-3, rtol=0)
    assert changed == [5, 10]
    env.close()


def test_nan_pose_sees_nothing():
    sensor = camera()
    sensor._data.xpos[:] = np.nan
    assert (sensor.data == 2.0).all()
    for bodies, problem in ((ROBOT, "no terrain"), ('<geom name="b" size="1"/>', r"b.*sphere")):
        with pytest.raises(RenetError, match=problem):
            terrain_shapes(scene(bodies))
    for cfg, problem in (
        (DepthCameraCfg(name="d", body="head"), r"'head'.*robot"),
        (FeetHeightCfg(name="f", sites=("paw",)), r"'paw'.*foot"),
    ):
        with pytest.raises(KeyError, match=problem):
            cfg.build().initialize(FLAT, None, None, "cpu")
    for delay in ((0.1, 0.0), (-0.02, 0.0), (0.0, math.inf)):
        with pytest.raises(RenetError, match="camera delay"):
            DepthCameraCfg(name="d", delay=delay).build()
