"""Pinhole rays, by hand."""

import numpy as np
import pytest

from renet.camera import Intrinsics


def test_each_intrinsic_acts_on_its_own_axis():
    rays = Intrinsics(height=2, width=3, fx=10.0, fy=20.0, cx=1.0, cy=0.75).rays()
    # Pixel centres: columns 0.5, 1.5, 2.5 and rows 0.5, 1.5; left and up are positive.
    left, up = (0.05, -0.05, -0.15), (0.0125, -0.0375)
    np.testing.assert_allclose(rays, [[1.0, y, z] for z in up for y in left])
    assert Intrinsics().rays(np.float32).dtype == np.float32


def test_the_default_crop_is_66_by_52_degrees_with_square_pixels():
    camera = Intrinsics()
    half = np.arctan([camera.width / 2 / camera.fx, camera.height / 2 / camera.fy])
    np.testing.assert_allclose(np.degrees(2 * half), [66.0, 52.0], atol=0.1)
    assert camera.fx == pytest.approx(camera.fy, rel=1e-4)
