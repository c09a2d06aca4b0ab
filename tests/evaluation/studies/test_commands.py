"""What a robot did of what it was told, against numbers by hand."""

import csv

import numpy as np
import pytest

from renet.errors import RenetError
from renet.evaluation.env import SimEnv, study_env_cfg
from renet.evaluation.motion import Motion, MotionSensor
from renet.evaluation.studies.commands import TWISTS, CommandStudy, drift, summary_of
from renet.tasks.parkour_env_cfg import flat_env_cfg

from ..fakes import FakeEvaluator


@pytest.fixture(scope="module")
def twist_env():
    """Two robots that are told twists."""
    cfg = study_env_cfg(flat_env_cfg(play=True), 0.6, told="twist")
    return SimEnv(cfg, [0, 1], 1, "auto")


def motion(twist, position=(0.0, 0.0)) -> Motion:
    """Two robots of which the second one stands."""
    return Motion(
        twist=np.array((twist, (0.0, 0.0, 0.0))),
        position=np.array((position, (0.0, 0.0))),
        slip=np.array((0.1, 0.0)),
        power=np.array((50.0, 10.0)),
        torque=np.array((20.0, 5.0)),
    )


def test_errors_are_those_of_the_means():
    # It sways by 0.2 m/s and turns to and fro: only means count.
    motions = [motion((0.5, 0.2, 0.3), (0.0, 0.0)), motion((0.5, -0.2, -0.1), (1.0, 0.02))]
    summary = summary_of(motions, np.array([0]), np.array((0.6, 0.0, 0.0)))
    assert summary["done"] == pytest.approx((0.5, 0.0, 0.1))
    assert summary["speed_error"] == pytest.approx(0.1)
    assert summary["yaw_rate_error"] == pytest.approx(0.1)
    assert summary["drift_m"] == pytest.approx(0.1), "2 cm in a metre"
    assert (summary["slip"], summary["power"], summary["peak_torque"]) == (0.1, 50.0, 20.0)


def test_robots_that_all_fell_have_no_numbers():
    summary = summary_of([motion((0.5, 0.0, 0.0))], np.array([], int), np.array((0.6, 0.0, 0.0)))
    assert set(summary.values()) == {None}


def test_a_command_at_which_all_robots_fell_is_in_the_results(tmp_path, monkeypatch):
    walked = summary_of([motion((0.6, 0.0, 0.0))] * 2, np.array([0]), np.array((0.6, 0.0, 0.0)))
    fallen = summary_of([motion((0.6, 0.0, 0.0))], np.array([], int), np.array((1.0, 0.0, 0.0)))
    rows = []
    for speed, measured in ((0.6, walked), (1.0, fallen)):
        row = {"mode": "camera", "command": [speed, 0.0, 0.0], "robots": 2, "falls": 2}
        rows.append(row | measured)
    monkeypatch.setattr(CommandStudy, "parts", lambda *_: {"runs": lambda: {"runs": rows}})
    CommandStudy(tmp_path, modes=("camera",)).run(FakeEvaluator())
    with (tmp_path / "summary.csv").open() as file:
        powers = [row["power"] for row in csv.DictReader(file)]
    assert powers == ["50.0", ""]
    assert (tmp_path / "commands.png").exists()


@pytest.mark.parametrize(
    ("command", "end", "expected"),
    [
        ((0.5, 0.0, 0.0), (2.0, -0.2), 0.5),
        ((-0.5, 0.0, 0.0), (-2.0, 0.2), 0.5),
        ((0.0, 0.3, 0.0), (0.1, 1.0), 0.5),
        ((0.5, 0.0, 0.3), (2.0, 0.2), None),
        ((0.0, 0.0, 0.0), (0.0, 0.0), None),
        ((0.5, 0.0, 0.0), (0.2, 0.2), None),
    ],
)
def test_drift_is_aside_of_the_way_that_was_told(command, end, expected):
    positions = np.array([[(0.0, 0.0)], [end]])
    assert drift(positions, np.array(command)) == (expected and pytest.approx(expected))


def test_a_policy_told_a_heading_is_refused(tmp_path):
    with pytest.raises(RenetError, match="cannot be asked to walk backward"):
        CommandStudy(tmp_path, quick=True).run()


def test_twelve_commands_in_all_directions():
    forward, left, turn = np.array(TWISTS).T
    assert len(TWISTS) == 12
    for axis in (forward, left, turn):
        assert axis.min() < 0.0 < axis.max()


def test_motion_is_read_in_the_robots_own_frame(twist_env):
    """A robot that slides to its left, seen from the world at another heading."""
    env = twist_env
    env.reset()
    data = env.env.sim.data
    data.qpos[:, 3:7] = data.qpos.new_tensor((np.cos(1.0), 0.0, 0.0, np.sin(1.0)))
    data.qvel[:] = 0.0
    data.qvel[:, 0] = -0.4 * np.sin(2.0)
    data.qvel[:, 1] = 0.4 * np.cos(2.0)
    data.qvel[:, 5] = 0.7
    env.env.sim.forward()
    read = MotionSensor(env).read()
    np.testing.assert_allclose(read.twist, [(0.0, 0.4, 0.7)] * env.num_robots, atol=1e-4)
    assert (read.slip == 0.0).all()
