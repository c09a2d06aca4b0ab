"""Who stops before what nobody can cross: one policy that never moves, and one that walks on."""

import numpy as np

from renet.evaluation.evaluator import Evaluator
from renet.evaluation.studies.stops import StopsStudy


class Still:
    """Holds the default pose."""

    def __init__(self, robots: int) -> None:
        self.anomaly_score = np.zeros(robots)

    def reset(self, mask=None) -> None: ...

    def step(self, proprioception, depth, op_mask):
        return np.zeros((len(proprioception), 12), np.float32)


class StillEvaluator(Evaluator):
    def make_policy(self, num_robots):
        return Still(num_robots)


def test_robots_that_stand_do_not_fall_and_have_not_walked(tmp_path):
    study = StopsStudy(tmp_path, quick=True, seconds=1.0, angles=(30.0,), conditions="nominal")
    runs = study.run(StillEvaluator(conditions="nominal"))["runs"]
    assert [(run["kind"], run["angle_deg"]) for run in runs] == [("wall", 30.0), ("ledge", 30.0)]
    for run in runs:
        assert (run["success_rate"], run["falls"], run["robots"]) == (1.0, 0, 6)
        assert run["walked_m"] < 0.1


def test_the_shipped_policy_walks_over_an_edge(tmp_path):
    study = StopsStudy(
        tmp_path,
        quick=True,
        seconds=6.0,
        kinds=("ledge",),
        angles=(0.0,),
        conditions="nominal",
    )
    (run,) = study.run()["runs"]
    assert run["falls"] == run["robots"] == 6
    assert run["walked_m"] is None
