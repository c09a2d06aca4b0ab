"""The simulated environment: tiles, twins, and physical faults, which change rays alone."""

from dataclasses import replace

import numpy as np
import pytest

from renet.errors import RenetError
from renet.evaluation.env import SimEnv, study_env_cfg
from renet.evaluation.rollout import Rollout, Trial
from renet.faults import Injection, ViewPerturbation
from renet.selector import SelectorSpec, make_selector
from renet.tasks.parkour_env_cfg import tile_env_cfg
from renet.tasks.sensors import DEPTH_CAMERA
from renet.tasks.terrains import tile_row
from renet.terrain.tiles import LEVELS, TILE, tiles

from .fakes import FakePolicy


def quiet(cfg):
    """A study's world whose camera has no noise and a nominal mount."""
    camera = next(sensor for sensor in cfg.scene.sensors if sensor.name == DEPTH_CAMERA)
    camera.noise.relative_std = camera.noise.gaussian_std = 0.0
    camera.mount = replace(camera.mount, position_error=0.0, angle_error=0.0)
    return cfg


@pytest.fixture(scope="module")
def tile() -> SimEnv:
    cfg = tile_env_cfg(tile_row({"platform": 8}), play=True)
    return SimEnv(quiet(study_env_cfg(cfg, 0.5)), [0, 0, 0, 0], 3, "native")


def seen(world: SimEnv, **rows: dict[int, object]) -> np.ndarray:
    """Images after a reset; a perturbation of some robots' cameras is given by its fields."""
    view = ViewPerturbation.none(world.num_robots)
    for name, values in rows.items():
        for row, value in values.items():
            getattr(view, name)[row] = value
    world.perturb_cameras(view)
    depth = world.reset().depth.astype(np.float32)
    world.perturb_cameras(ViewPerturbation.none(world.num_robots))
    return depth


@pytest.fixture(scope="module")
def true(tile: SimEnv) -> np.ndarray:
    return seen(tile)


def test_foam_brings_the_ground_nearer_by_what_it_is_high() -> None:
    flat = SimEnv(quiet(study_env_cfg("Renet-Go1-Flat", 0.5)), [0, 0], 3, "native")
    depth = seen(flat, lift={1: 0.1})
    eye = flat.env.sim.data.qpos[0, 2].item() + 0.03  # The head is level with the trunk, about.
    both = (depth < 1.0).all(axis=0)
    ratio = depth[1][both] / depth[0][both]
    # Every ray that ends on the ground is shorter in the proportion of the eye's heights.
    assert ratio.std() < 0.01
    pitch = 0.27 * abs(flat.env.sim.data.qpos[0, 5].item())
    assert ratio.mean() == pytest.approx((eye - 0.1) / eye, abs=0.1 + pitch)
    assert 0.4 < ratio.mean() < 0.85


def test_only_the_disturbed_robots_see_it(tile: SimEnv, true: np.ndarray) -> None:
    depth = seen(tile, lift={1: 0.1}, turn={2: (0.0, 0.2, 0.0)}, glass={3: 1.0})
    np.testing.assert_array_equal(depth[0], true[0])
    assert ((np.abs(depth - true)[1:] > 0.02).mean(axis=(1, 2)) > 0.05).all()


def test_a_pitched_camera_sees_what_was_rows_away(tile: SimEnv, true: np.ndarray) -> None:
    down = seen(tile, turn={0: (0.0, 0.1, 0.0)})[0]
    # Pitch is positive downwards: the picture's lower rows move up.
    shift = int(np.argmin([np.abs(down[:40] - true[0, k : 40 + k]).mean() for k in range(9)]))
    assert shift == pytest.approx(0.1 * 24.0 / 0.4875, abs=1.1)


def test_glass_shows_the_ground_behind(tile: SimEnv, true: np.ndarray) -> None:
    clear = seen(tile, glass={0: 1.0})[0]
    assert (clear >= true[0] - 2e-3).all()
    assert (clear > true[0] + 0.05).any()


def test_glass_needs_obstacles() -> None:
    flat = SimEnv(study_env_cfg("Renet-Go1-Flat", 0.5), [0], 3, "native")
    with pytest.raises(RenetError, match="no obstacle that could be glass"):
        seen(flat, glass={0: 1.0})


def test_a_physical_fault_comes_and_goes_with_its_schedule(tile: SimEnv) -> None:
    foam = (Injection("foam", 0.15, onset=10, duration=0.2),)
    rows = [Trial("op", foam), Trial("op"), Trial("op", foam), Trial("op")]
    selector = make_selector("paper", SelectorSpec(beta=1.0), 4)
    film = Rollout(tile, FakePolicy(4), selector, rows, 0).run(30, film=[0, 1]).film
    assert film is not None
    gap = np.abs(film.images[:, 0].astype(float) - film.images[:, 1]).mean(axis=(1, 2))
    disturbed = gap > 5 * gap[:2].max() + 1
    np.testing.assert_array_equal(disturbed, [False, False, True, True, False, False])


def test_robots_stand_on_the_tiles_they_are_placed_on() -> None:
    kinds, levels = np.array([4, 2, 3, 5]), np.array([0, 9, 4, 2])
    world = SimEnv(study_env_cfg("Renet-Go1-Parkour", 0.5), range(4), 1, "auto")
    world.place(levels, kinds)
    result = world.reset()
    assert ((result.height > 0.2) & (result.height < 0.4)).all()
    np.testing.assert_allclose(result.proprioception[:, 6], 0.5)
    position = world.env.scene["robot"].data.root_link_pos_w.numpy()
    # Rows of the terrain lie along x, columns along y, one tile apart.
    order = np.argsort(levels)
    np.testing.assert_allclose(np.diff(position[order, 0]), TILE * np.diff(levels[order]), atol=0.7)
    rise = tiles()["stairs_up"].measure(9 / (LEVELS - 1))
    assert position[1, 2] < -5 * rise
    for _ in range(5):
        result = world.step(np.zeros((4, 12), np.float32))
    assert not result.ended.any()
    assert result.travelled.max() < 0.3
