"""tools/fault_gallery.py: every fault has a picture, and motion blur is what a camera sees."""

import numpy as np
import pytest

from fault_gallery import example, scene
from renet.faults import FAULTS, Frames, Injection, Injector, ViewPerturbation
from renet.interface import DEPTH_SHAPE


def test_motion_blur_is_the_mean_of_what_a_turning_camera_sees():
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
def test_every_fault_has_its_picture(fault):
    pictures = [example(fault, severity, 0) for severity in (1, 5)]
    assert all(p.shape == DEPTH_SHAPE and 0 <= p.min() <= p.max() <= 1 for p in pictures)
    if fault != "dropped":  # The frame shown may be one that was not lost.
        assert (pictures[1] != scene()).any()
