"""Drawings of the camera's mount: the bundle's numbers, on the robot's own shapes."""

import math
import re
from pathlib import Path

import numpy as np
import pytest

import mount_drawing
from renet.bundle import SHIPPED, Bundle

FIGURES = Path(__file__).parents[1] / "docs" / "figures"


@pytest.mark.parametrize("name", SHIPPED)
def test_the_drawings_of_the_docs_have_the_numbers_of_the_bundle(name):
    camera = Bundle.load(name).manifest.camera
    texts = re.findall(r">([^<>]+)</text>", (FIGURES / f"{name[:3]}_mount.svg").read_text())
    x, y, z = camera.position
    assert texts.count(f"{1000 * x:g} mm") == 2
    assert f"{1000 * z:g} mm" in texts
    assert f"{math.degrees(camera.pitch):.0f}° down" in texts
    hip = mount_drawing.front_joints(Bundle.load(name).manifest.robot)
    assert mount_drawing.millimetres(x - hip) in texts
    assert ("centred" in texts) == (y == 0.0)
    assert any(text.startswith(f"{1000 * abs(y):g} mm ") for text in texts) == (y != 0.0)


@pytest.mark.parametrize("name", SHIPPED)
def test_a_drawn_robot_stands_on_its_feet(name):
    shapes, trunk = mount_drawing.robot_shapes(Bundle.load(name).manifest.robot)
    assert min(points[:, 2].min() for points in shapes) == pytest.approx(0.0)
    on_ground = [points for points in shapes if points[:, 2].min() < 0.01]
    assert len(on_ground) == 4
    ahead = sorted(float(points[:, 0].mean()) for points in on_ground)
    assert np.diff(ahead)[1] > 0.3, "two feet in front and two behind"
    assert 0.2 < trunk[2] < 0.4


@pytest.mark.parametrize("name", SHIPPED)
def test_the_axis_meets_the_floor_where_the_middle_row_shows_it(name):
    camera = Bundle.load(name).manifest.camera
    height = 0.4
    ahead = mount_drawing.floor_distance(camera, height)
    # A point of the floor in the frame of the lens: turned by the pitch about the lateral axis.
    forward = ahead * math.cos(camera.pitch) + height * math.sin(camera.pitch)
    down = height * math.cos(camera.pitch) - ahead * math.sin(camera.pitch)
    assert camera.cy + camera.fy * down / forward == pytest.approx(camera.cy)


def test_front_joints_are_ahead_of_the_middle_and_behind_the_lens():
    for name in SHIPPED:
        manifest = Bundle.load(name).manifest
        assert 0.15 < mount_drawing.front_joints(manifest.robot) < manifest.camera.position[0]
