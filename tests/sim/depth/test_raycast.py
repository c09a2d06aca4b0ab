"""The terrain mesh and its ray caster against MuJoCo's own rays."""

import mujoco
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.sim.scenes import mujoco_rays, scene

from renet.camera import Intrinsics
from renet.sim.depth.camera import mount_rotation
from renet.sim.depth.rasterizer import Rasterizer
from renet.sim.depth.raycast import TerrainScanner
from renet.sim.depth.terrain_mesh import terrain_shapes

RANGE = 2.0
RAYS = torch.from_numpy(Intrinsics().rays(np.float32))


def assert_sees_what_mujoco_sees(model: mujoco.MjModel, eye, rotation: torch.Tensor) -> int:
    """Compare every fifth pixel; at most 1 in 50 may lie on an edge and see past it.

    Images drawn and rays cast, which are not the same code.
    """
    expected = mujoco_rays(model, eye, (RAYS[::5] @ rotation[0].T).numpy())
    expected[expected > RANGE] = -1.0
    for scanner in (Rasterizer(model), TerrainScanner(model, "cpu")):
        got = scanner.depth(torch.tensor(eye)[None], rotation, Intrinsics(), RANGE)[0, ::5]
        differs = np.abs(got.numpy() - expected) > 1e-3
        assert differs.mean() <= 0.02
    return int((expected >= 0).sum())


BUMPS = np.random.default_rng(3).random(7 * 5)
SOLID = (
    '<asset><hfield name="f" nrow="7" ncol="5" size="0.8 0.9 0.4 0.2" '
    f'elevation="{" ".join(map(str, BUMPS))}"/></asset>'
)
CLUTTER = """<geom type="plane" size="0 0 1" pos="0 0 -0.4"/>
  <geom type="hfield" hfield="f" pos="0.2 0.1 0" euler="0 0 20"/>
  <geom type="box" size="0.2 0.3 0.1" pos="-0.8 0.4 0.1" euler="10 20 30"/>
  <geom type="box" size="0.3 0.1 0.5" pos="1.2 -0.8 0.1"/>"""


@settings(max_examples=30)
@given(
    angle=st.floats(-np.pi, np.pi),
    height=st.floats(-0.3, 1.2),
    pitch=st.floats(-0.6, 1.4),
    aside=st.floats(-0.6, 0.6),
)
def test_images_from_anywhere_agree_with_mujoco(angle, height, pitch, aside):
    eye = np.array([-1.6 * np.cos(angle), -1.6 * np.sin(angle), height], np.float32)
    rotation = mount_rotation(torch.tensor([pitch]), torch.tensor([angle + aside]))
    assert_sees_what_mujoco_sees(scene(CLUTTER, extra=SOLID), eye, rotation)


@pytest.mark.parametrize("yaw", [0.0, np.pi / 2, np.pi, 3 * np.pi / 2])
def test_a_height_field_has_walls_and_a_base(yaw):
    model = scene('<geom type="hfield" hfield="f"/>', extra=SOLID)
    beside = np.array([-1.9 * np.cos(yaw), -1.9 * np.sin(yaw), 0.05], np.float32)
    below = np.array([0.01, 0.02, -1.0], np.float32)
    for eye, pitch, least in ((beside, 0.0, 100), (below, -np.pi / 2, 500)):
        rotation = mount_rotation(*torch.tensor([[pitch], [yaw]], dtype=torch.float32))
        assert assert_sees_what_mujoco_sees(model, eye, rotation) > least


def test_a_flat_height_field_has_no_empty_triangles():
    flat = f'<hfield name="f" nrow="3" ncol="3" size="1 1 1 1" elevation="{"0 " * 9}"/>'
    model = scene('<geom type="hfield" hfield="f"/>', extra=f"<asset>{flat}</asset>")
    _, triangles = terrain_shapes(model)
    a, b, c = np.moveaxis(triangles, 1, 0)
    assert (np.linalg.norm(np.cross(b - a, c - a), axis=-1) > 0).all()
    assert len(triangles) == 2 * 4 + 10  # The surface, and a box without its top.


def test_rays_see_only_what_is_fixed_and_collides_and_planes_beyond_their_drawn_size():
    model = scene(
        '<geom type="plane" size="1 1 1" pos="0 0 .1"/>'
        '<geom type="box" size="1 1 2" contype="0" conaffinity="0"/>'
        '<body mocap="true"><geom type="box" size="1 1 3"/></body>'
        '<body><freejoint/><geom type="box" size="1 1 4"/></body>'
    )
    heights = Rasterizer(model).height(torch.tensor([[0.0, 0.0], [50.0, -80.0]]))
    torch.testing.assert_close(heights, torch.full((2,), 0.1), atol=1e-4, rtol=0)


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_a_gpu_sees_what_the_cpu_sees():
    model = scene(CLUTTER, extra=SOLID)
    eyes = torch.tensor([[-1.6, 0.1, 0.5], [float("nan"), 0.0, 0.5]])
    rotation = mount_rotation(torch.tensor([0.5, 0.5]), torch.zeros(2))
    cpu = Rasterizer(model).depth(eyes, rotation, Intrinsics(), RANGE)
    poses = eyes.cuda(), rotation.cuda()
    gpu = TerrainScanner(model, "cuda:0").depth(*poses, Intrinsics(), RANGE)
    assert (cpu[0] >= 0).any()
    assert (gpu[1] < 0).all()
    assert ((gpu.cpu() - cpu).abs() > 1e-4).float().mean() < 0.01
