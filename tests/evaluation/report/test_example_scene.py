from __future__ import annotations

import mujoco
import numpy as np
import pytest

from renet.evaluation.report.example_scene import BLOCKS, EYE, TILT, example, scene
from renet.faults import FAULTS, Frames, Injection, Injector, ViewPerturbation
from renet.faults.image import FOCAL_PIXELS
from renet.interface import DEPTH_SHAPE


def rotation(vector: np.ndarray) -> np.ndarray:
    """MuJoCo's matrix [3, 3] of a rotation vector."""
    quaternion, matrix = np.zeros(4), np.zeros(9)
    angle = float(np.linalg.norm(vector))
    mujoco.mju_axisAngle2Quat(quaternion, vector / max(angle, 1e-12), angle)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)


def by_mujoco(view: ViewPerturbation, blocks: np.ndarray) -> np.ndarray:
    """The same picture by MuJoCo's ray caster."""
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=(0, 0, 1))
    for low, high in blocks:
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX, size=(high - low) / 2, pos=(high + low) / 2
        )
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    eye = np.array([0.0, 0.0, EYE - view.lift[0]])
    depth = np.empty(DEPTH_SHAPE)
    axes = np.array(
        [[np.cos(TILT), 0, np.sin(TILT)], [0, 1, 0], [-np.sin(TILT), 0, np.cos(TILT)]]
    ) @ rotation(view.turn[0])
    for row in range(DEPTH_SHAPE[0]):
        for column in range(DEPTH_SHAPE[1]):
            ray = axes @ (1.0, (31.5 - column) / FOCAL_PIXELS, (23.5 - row) / FOCAL_PIXELS)
            length = float(np.linalg.norm(ray))
            far = mujoco.mj_ray(model, data, eye, ray / length, None, 1, -1, np.zeros(1, np.int32))
            depth[row, column] = far / length if far >= 0 else np.inf
    return np.clip(depth / 2.0, 0, 1)


@pytest.mark.parametrize(
    ("view", "blocks"),
    [
        (ViewPerturbation.none(1), BLOCKS),
        (ViewPerturbation(np.array([0.15]), np.zeros((1, 3)), np.zeros(1)), BLOCKS),
        (ViewPerturbation(np.zeros(1), np.array([[0.1, -0.2, 0.15]]), np.zeros(1)), BLOCKS),
        (ViewPerturbation(np.zeros(1), np.zeros((1, 3)), np.array([0.4])), BLOCKS[[1, 3, 4]]),
    ],
)
def test_the_scene_is_what_mujoco_sees(view: ViewPerturbation, blocks: np.ndarray) -> None:
    wrong = np.abs(scene(view) - by_mujoco(view, blocks)) > 1e-4
    # A ray that grazes an edge may fall on either side of it.
    assert wrong.mean() < 0.002


def test_motion_blur_is_the_mean_of_what_a_turning_camera_sees() -> None:
    seconds, rates = 0.04, np.array([0.0, 4.0, 4.0])
    turns = np.linspace(-0.5, 0.5, 9)[:, None] * seconds * rates
    views = [ViewPerturbation(np.zeros(1), turn[None], np.zeros(1)) for turn in turns]
    seen = np.mean([scene(view) for view in views], axis=0)
    blur = Injector([(Injection("motion_blur", 1000 * seconds, 0),)], [0], 0)

    def error(rate: np.ndarray) -> float:
        blurred = blur.apply(Frames.healthy(scene()[None], rate[None]), 0).image[0]
        return float(np.abs(blurred - seen)[4:-4, 4:-4].mean())

    assert error(rates) < 0.5 * error(rates * (1.0, -1.0, 1.0))
    assert error(rates) < 0.5 * error(np.zeros(3))


@pytest.mark.parametrize("fault", FAULTS)
def test_every_fault_has_its_picture(fault: str) -> None:
    pictures = [example(fault, severity, 0) for severity in (1, 5)]
    assert all(picture.shape == DEPTH_SHAPE for picture in pictures)
    assert all(picture.min() >= 0 and picture.max() <= 1 for picture in pictures)
    if fault != "dropped":  # The frame shown may be one that was not lost.
        assert (pictures[1] != scene()).any()
