"""Faults of the scene: views that compose, and images that pass untouched."""

import numpy as np
import pytest

from renet.errors import RenetError
from renet.faults import Frames, Injection, Injector
from renet.faults.physical import spread


def test_cameras_without_a_simulator_refuse_physical_faults() -> None:
    for name in ("glass", "foam", "mount_knocked"):
        with pytest.raises(RenetError, match="only a simulated world"):
            Injector([(Injection.of(name, 3),)], [0], 0)


def test_views_compose_and_images_pass_untouched() -> None:
    schedule = (
        Injection("foam", 0.1, 0),
        Injection("foam", 0.02, 10),
        Injection("glass", 0.4, 0),
        Injection("mount_knocked", 10.0, 0),
    )
    injector = Injector([schedule, ()], [0, 1], 5, physical=True)
    late = injector.perturbation(10)
    np.testing.assert_allclose(injector.perturbation(0).lift, [0.1, 0.0])
    np.testing.assert_allclose(late.lift, [0.12, 0.0])
    np.testing.assert_allclose(late.glass, [0.4, 0.0])
    assert np.degrees(np.linalg.norm(late.turn[0])) == pytest.approx(10.0)
    assert not late.turn[1].any()
    image = np.random.default_rng(0).random((2, 48, 64), np.float32)
    np.testing.assert_array_equal(injector.apply(Frames.healthy(image), 10).image, image)
    assert injector.at_work(10).tolist() == [True, False]


@pytest.mark.parametrize(("count", "share", "expected"), [(4, 0.2, 1), (24, 0.2, 5), (24, 1.0, 24)])
def test_a_share_of_the_obstacles_at_least_one(count: int, share: float, expected: int) -> None:
    tiles = [list(range(count)), list(range(100, 100 + count))]
    chosen = spread(tiles, share)
    assert [len(chosen & set(geoms)) for geoms in tiles] == [expected, expected]
    assert len(chosen) == 2 * expected
