"""What a CPU draws and what rays hit, against each other and against MuJoCo's own rays."""

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
LENS = Intrinsics()
RAYS = torch.from_numpy(LENS.rays(np.float32))


def assert_sees_what_mujoco_sees(model: mujoco.MjModel, eye, rotation: torch.Tensor) -> int:
    """Compare every fifth pixel; at most 1 in 50 may lie on an edge and see past it.

    Images drawn and rays cast, which are not the same code.
    """
    expected = mujoco_rays(model, eye, (RAYS[::5] @ rotation[0].T).numpy())
    expected[expected > RANGE] = -1.0
    for scanner in (Rasterizer(model), TerrainScanner(model, "cpu")):
        got = scanner.depth(torch.tensor(eye)[None], rotation, LENS, RANGE)[0, ::5]
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
def test_height_field_has_walls_and_base(yaw):
    model = scene('<geom type="hfield" hfield="f"/>', extra=SOLID)
    beside = np.array([-1.9 * np.cos(yaw), -1.9 * np.sin(yaw), 0.05], np.float32)
    below = np.array([0.01, 0.02, -1.0], np.float32)
    for eye, pitch, least in ((beside, 0.0, 100), (below, -np.pi / 2, 500)):
        rotation = mount_rotation(*torch.tensor([[pitch], [yaw]], dtype=torch.float32))
        assert assert_sees_what_mujoco_sees(model, eye, rotation) > least


def test_flat_height_field_has_no_empty_triangles():
    flat = f'<hfield name="f" nrow="3" ncol="3" size="1 1 1 1" elevation="{"0 " * 9}"/>'
    model = scene('<geom type="hfield" hfield="f"/>', extra=f"<asset>{flat}</asset>")
    _, triangles = terrain_shapes(model)
    a, b, c = np.moveaxis(triangles, 1, 0)
    assert (np.linalg.norm(np.cross(b - a, c - a), axis=-1) > 0).all()
    assert len(triangles) == 2 * 4 + 10  # The surface, and a box without its top.


def test_rays_hit_static_colliding_geoms():
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
    cpu = Rasterizer(model).depth(eyes, rotation, LENS, RANGE)
    poses = eyes.cuda(), rotation.cuda()
    gpu = TerrainScanner(model, "cuda:0").depth(*poses, LENS, RANGE)
    assert (cpu[0] >= 0).any()
    assert (gpu[1] < 0).all()
    assert ((gpu.cpu() - cpu).abs() > 1e-4).float().mean() < 0.01


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    """A plane, a wide box, a height field, and boxes that overlap at all angles."""
    random = np.random.default_rng(4)
    boxes = "".join(
        '<geom type="box" size="{} {} {}" pos="{} {} {}" euler="{} {} {}"/>'.format(
            *random.uniform(0.02, 0.6, 3),
            *random.uniform(-3, 3, 2),
            random.uniform(-0.2, 0.6),
            *(random.uniform(-40, 40, 3) * (i % 2)),
        )
        for i in range(60)
    )
    bumps = " ".join(map(str, random.random(81)))
    field = f'<hfield name="f" nrow="9" ncol="9" size="1 1 .3 .2" elevation="{bumps}"/>'
    geoms = """<geom type="plane" size="0 0 1" pos="0 0 -.6"/>
        <geom type="box" size="30 30 .1" pos="5 0 -.5"/>
        <geom type="hfield" hfield="f" pos="1 1 -.1" euler="5 -10 30"/>"""
    return scene(geoms, boxes, extra=f"<asset>{field}</asset>")


@pytest.fixture(scope="module")
def scanner(model) -> Rasterizer:
    return Rasterizer(model)


@pytest.fixture(scope="module")
def caster(model) -> TerrainScanner:
    return TerrainScanner(model, "cpu")


@settings(max_examples=40)
@given(
    x=st.floats(-4, 4),
    y=st.floats(-4, 4),
    z=st.floats(-0.395, 1.0),  # On a surface either answer would be right.
    pitch=st.floats(-1.5, 1.5),
    yaw=st.floats(-4, 4),
    limit=st.sampled_from([0.3, 2.0, 9.0]),
)
def test_images_match_rays_inside_boxes(scanner, caster, x, y, z, pitch, yaw, limit):
    eye = torch.tensor([[x, y, z]])
    rotation = mount_rotation(torch.tensor([pitch]), torch.tensor([yaw]))
    drawn = scanner.depth(eye, rotation, LENS, limit)
    cast = caster.depth(eye, rotation, LENS, limit)  # Rays that graze an edge may differ.
    assert ((drawn - cast).abs() > 1e-3).float().mean() < 0.002


def test_cameras_are_independent_in_a_batch(scanner):
    random = torch.Generator().manual_seed(0)
    eyes = torch.rand(37, 3, generator=random) * torch.tensor([6.0, 6.0, 0.5]) - 3.0
    rotation = mount_rotation(*torch.rand(2, 37, generator=random))
    together = scanner.depth(eyes, rotation, LENS, 2.0)
    alone = [scanner.depth(eyes[i : i + 1], rotation[i : i + 1], LENS, 2.0) for i in range(37)]
    assert torch.equal(together, torch.cat(alone))


@pytest.mark.parametrize("number", [float("nan"), float("inf")])
def test_nan_pose_harms_no_other(scanner, number):
    eyes = torch.tensor([[0.0, -2.0, 0.8]] * 3)
    rotation = mount_rotation(torch.full((3,), 0.5), torch.zeros(3))
    whole = scanner.depth(eyes, rotation, LENS, 2.0)[0]
    eyes[0, 1] = rotation[1, 2, 0] = number
    first, second, third = scanner.depth(eyes, rotation, LENS, 2.0)
    assert (torch.stack((first, second)) == -1.0).all()
    assert torch.equal(third, whole)
    ground = scanner.height(torch.tensor([[number, 0.0], [0.0, -2.0]]))
    assert ground[0] == pytest.approx(scanner.top - scanner.drop)
    assert ground[1] > -0.61


@pytest.mark.parametrize("turned", [True, False])
@pytest.mark.parametrize("frames", [3, 600])  # One thread, and all.
def test_clearances_are_those_rays_find(scanner, caster, frames, turned):
    random = torch.Generator().manual_seed(1)
    position = torch.rand(frames, 3, generator=random) * 6 - 3
    pattern = torch.rand(7, 2, generator=random) * 2 - 1
    rotation = mount_rotation(*torch.rand(2, frames, generator=random) * 3) if turned else None
    heights = scanner.clearance(position, rotation, pattern)
    cast = caster.clearance(position, rotation, pattern)
    assert heights.shape == (frames, 7)
    assert ((heights - cast).abs() > 1e-4).float().mean() < 0.002


def test_heights_are_independent_of_position(scanner):
    points = torch.rand(400, 2, generator=torch.Generator().manual_seed(1)) * 10 - 5
    over = scanner.clearance(torch.zeros(1, 3), None, points)[0]
    torch.testing.assert_close(scanner.height(points), -over)
    far = torch.tensor([[120.0, -150.0]])
    torch.testing.assert_close(scanner.height(far), torch.tensor([-0.6]))


def test_it_takes_views_and_double_precision(scanner):
    points = torch.rand(4000, 2, generator=torch.Generator().manual_seed(1)) * 10 - 5
    heights = scanner.height(points)
    for same in (points.double(), points.T.contiguous().T):
        assert torch.equal(scanner.height(same), heights)
    frames = torch.rand(5, 4, 3, generator=torch.Generator().manual_seed(2))
    turns = torch.eye(3).repeat(5, 4, 1, 1)
    third = scanner.clearance(frames[:, 2], turns[:, 1], points[:9])
    copies = frames[:, 2].clone(), turns[:, 1].clone(), points[:9].double()
    assert torch.equal(scanner.clearance(*copies), third)
    eyes, rotation = torch.tensor([[0.0, -2.0, 0.8]]), mount_rotation(torch.ones(1), torch.ones(1))
    doubles = scanner.depth(eyes.double(), rotation.double(), LENS, 2.0)
    assert torch.equal(doubles, scanner.depth(eyes, rotation, LENS, 2.0))


def test_touching_boxes_leave_no_gap():
    pair = "".join(f'<geom type="box" size="1 1 .1" pos="{x} 0 0"/>' for x in (-1, 1))
    touching = Rasterizer(scene(pair))
    seam = torch.stack((torch.zeros(50), torch.linspace(-1, 1, 50)), -1)
    torch.testing.assert_close(touching.height(seam), torch.full((50,), 0.1))
    down = mount_rotation(torch.full((50,), torch.pi / 2), torch.zeros(50))
    eyes = torch.cat((seam * 0.3, torch.full((50, 1), 0.5)), dim=-1)
    torch.testing.assert_close(touching.depth(eyes, down, LENS, 2.0), torch.full((50, 3072), 0.4))
