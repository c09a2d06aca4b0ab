"""Height map and feet height against MuJoCo's rays, their stated geometry and their limits."""

from itertools import product
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from mjlab.utils.lab_api.math import matrix_from_quat, quat_from_euler_xyz
from tests.sim.scenes import PLANE, ROBOT, mujoco_rays, scene

from renet.interface import HEIGHT_MAP_X, HEIGHT_MAP_Y
from renet.sim.sensors import FeetHeight, FeetHeightCfg, HeightMap, HeightMapCfg

FLAT = scene(PLANE, ROBOT)


def height_map(model: mujoco.MjModel, position, rotation=(0.0, 0.0, 0.0)) -> HeightMap:
    """The sensor on one robot with the given base position and roll, pitch, yaw."""
    body = model.body("robot").id
    xpos, xmat = torch.zeros(1, model.nbody, 3), torch.zeros(1, model.nbody, 3, 3)
    xpos[0, body] = torch.tensor(position)
    xmat[0, body] = matrix_from_quat(quat_from_euler_xyz(*torch.tensor(rotation)))
    sensor = HeightMapCfg(name="map", body="robot").build()
    sensor.initialize(model, None, SimpleNamespace(xpos=xpos, xmat=xmat), "cpu")
    return sensor


def feet_height(model: mujoco.MjModel, feet: list[tuple[float, float, float]]) -> FeetHeight:
    """The sensor on robots that have one foot each."""
    sensor = FeetHeightCfg(name="feet", sites=("foot",)).build()
    sensor.initialize(model, None, SimpleNamespace(site_xpos=torch.tensor(feet)[:, None]), "cpu")
    return sensor


# Boxes at odd angles: no line of the grid runs along an edge, where either height would be right.
STEPS = PLANE + "".join(
    f'<geom type="box" size=".6 .4 {0.05 * i + 0.02}" euler="0 0 {17.3 + 41 * i}" '
    f'pos="{1.1 * np.cos(i)} {1.1 * np.sin(i)} 0"/>'
    for i in range(6)
)


@settings(max_examples=15)
@given(
    roll=st.floats(-0.6, 0.6),
    pitch=st.floats(-0.6, 0.6),
    yaw=st.floats(-3.1, 3.1),
    x=st.floats(-0.5, 0.5),
    y=st.floats(-0.5, 0.5),
)
def test_map_turns_with_yaw_only(roll, pitch, yaw, x, y):
    model = scene(STEPS, ROBOT)
    readings = height_map(model, (x, y, 0.4), (roll, pitch, yaw)).data[0].numpy()
    ahead, left = np.array([*product(HEIGHT_MAP_X, HEIGHT_MAP_Y)]).T
    at_x = x + ahead * np.cos(yaw) - left * np.sin(yaw)
    at_y = y + ahead * np.sin(yaw) + left * np.cos(yaw)
    starts = np.stack((at_x, at_y, np.full_like(at_x, 3.0)), axis=-1)
    ground = 3.0 - mujoco_rays(model, starts, (0, 0, -1), without=1)
    missed = np.abs(readings - (0.4 - 0.3 - ground)) > 1e-3
    assert missed.sum() <= 1  # A grid point may lie on a box's very edge.


def test_readings_are_clipped_to_their_limits():
    for height, reading in ((0.9, 0.6), (5.0, 1.0), (-4.0, -1.0)):
        readings = height_map(FLAT, (0.0, 0.0, height)).data
        torch.testing.assert_close(readings, torch.full((1, 132), reading))
    feet = feet_height(FLAT, [(0.0, 0.0, z + 0.023) for z in (-3.0, -0.1, 0.4, 7.0)])
    torch.testing.assert_close(feet.data[:, 0], torch.tensor([-0.2, -0.1, 0.4, 1.0]))


def test_foot_reads_mean_of_patch():
    # One of three columns of the 5 x 5 cm patch lies over a pit 0.3 m deep.
    ground = '<geom type="box" size="3 3 .15" pos="0 0 -.15"/>'
    model = scene('<geom type="box" size="1 1 .3"/>', ground, ROBOT)
    foot = (0.99, 0.0, 0.3 + 0.023)
    assert feet_height(model, [foot]).data.item() == pytest.approx(0.3 / 3, abs=1e-4)


def test_reading_is_cast_once_a_step():
    sensor = height_map(FLAT, (0.0, 0.0, 0.3))
    first = sensor.data
    sensor._data.xpos[..., 2] += 0.1
    assert sensor.data is first
    sensor.update(0.02)
    torch.testing.assert_close(sensor.data, first + 0.1)
    sensor._data.xpos[..., 2] += 0.1
    sensor.reset(torch.tensor([0]))
    torch.testing.assert_close(sensor.data, first + 0.2)
