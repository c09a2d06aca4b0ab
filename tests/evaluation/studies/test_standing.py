import numpy as np

from renet.evaluation.studies.standing import StandingStudy, stillness


def test_drift_counts_from_when_robots_should_stand_and_joints_all_along():
    poses = np.zeros((4, 1, 9))
    poses[:, 0, 0] = (0.0, 3.0, 3.0, 3.3)
    poses[:, 0, 1] = (0.0, 0.0, 0.0, 0.4)
    poses[:, 0, 7] = (0.0, 0.02, 0.02, 0.0)
    drift, speed = stillness(poses, settled=1)
    np.testing.assert_allclose(drift, 0.5)
    np.testing.assert_allclose(speed[:, 0], (0.5, 0.0, 0.5), atol=1e-12)


def test_robots_that_stop_stand_and_restless_ones_do_not(run_study):
    _, summary = run_study("standing")
    assert [(run["kind"], run["level"], run["mode"]) for run in summary["runs"]] == [
        (*place, mode) for place in (("flat", 1), ("stairs_up", 3)) for mode in ("camera", "blind")
    ]
    assert {(run["robots"], run["still"], run["falls"]) for run in summary["runs"]} == {(2, 1, 0)}
    assert all(run["drift_m"] == 0 for run in summary["runs"])


def test_flat_ground_has_one_level():
    groups = StandingStudy(kinds=("flat", "gap"), levels=(3, 5), modes=("blind",)).groups
    assert groups == [("flat", 1, "blind"), ("gap", 3, "blind"), ("gap", 5, "blind")]
    quick = StandingStudy(kinds=("flat", "gap"), levels=(5, 3), modes=("blind",), quick=True)
    assert quick.groups == [("flat", 1, "blind"), ("gap", 3, "blind")]
