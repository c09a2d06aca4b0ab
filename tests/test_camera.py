"""Pinhole rays and the camera's mount, by hand."""

from __future__ import annotations

import math

import pytest
import torch

from renet.camera import Intrinsics
from renet.sim.depth.camera import mount_rotation


def test_each_intrinsic_acts_on_its_own_axis():
    rays = Intrinsics(height=2, width=3, fx=10.0, fy=20.0, cx=1.0, cy=0.75).rays()
    # Pixel centres: columns 0.5, 1.5, 2.5 and rows 0.5, 1.5; left and up are positive.
    left, up = (0.05, -0.05, -0.15), (0.0125, -0.0375)
    expected = torch.tensor([[1.0, y, z] for z in up for y in left])
    torch.testing.assert_close(rays, expected)


def test_the_default_crop_is_66_by_52_degrees_with_square_pixels():
    camera = Intrinsics()
    assert 2 * math.degrees(math.atan(camera.width / 2 / camera.fx)) == pytest.approx(66.0, abs=0.1)
    assert 2 * math.degrees(math.atan(camera.height / 2 / camera.fy)) == pytest.approx(
        52.0, abs=0.1
    )
    assert camera.fx == pytest.approx(camera.fy, rel=1e-4)


def test_the_mount_is_a_rotation():
    pitch, yaw = torch.linspace(-1.0, 1.0, 9), torch.linspace(2.0, -2.0, 9)
    rotation = mount_rotation(pitch, yaw)
    eye = torch.eye(3).expand(9, 3, 3)
    torch.testing.assert_close(rotation @ rotation.mT, eye, atol=1e-6, rtol=0)
    torch.testing.assert_close(torch.linalg.det(rotation), torch.ones(9))
    torch.testing.assert_close(rotation[:, 2, 1], torch.zeros(9))  # It never rolls.
