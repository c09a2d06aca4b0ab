import numpy as np

from renet.evaluation.env import SimEnv, study_env_cfg
from renet.evaluation.studies.standing import stillness


def test_drift_counts_from_when_robots_should_stand_and_joints_all_along() -> None:
    poses = np.zeros((4, 1, 9))
    poses[:, 0, 0] = (0.0, 3.0, 3.0, 3.3)
    poses[:, 0, 1] = (0.0, 0.0, 0.0, 0.4)
    poses[:, 0, 7] = (0.0, 0.02, 0.02, 0.0)
    drift, speed = stillness(poses, settled=1)
    np.testing.assert_allclose(drift, 0.5)
    np.testing.assert_allclose(speed[:, 0], (0.5, 0.0, 0.5), atol=1e-12)


def test_robots_that_stop_stand_and_restless_ones_do_not(run_study) -> None:
    _, summary = run_study("standing")
    assert [(run["kind"], run["level"], run["mode"]) for run in summary["runs"]] == [
        ("flat", 1, "vp"), ("flat", 1, "op"), ("stairs_up", 3, "vp"), ("stairs_up", 3, "op")
    ]  # fmt: skip
    assert {(run["robots"], run["still"], run["falls"]) for run in summary["runs"]} == {(2, 1, 0)}
    assert all(run["drift_m"] == 0 for run in summary["runs"])


def test_the_simulated_world_obeys() -> None:
    world = SimEnv(study_env_cfg("Renet-Go1-Flat", 0.6), range(2), 1, "native")
    world.reset()
    world.command(0.0)
    after = world.step(np.zeros((2, 12), np.float32))
    np.testing.assert_allclose(after.proprioception[:, 6], 0.0)
