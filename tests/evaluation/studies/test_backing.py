"""Who backs out from an edge: by hand, a robot that never moves, and policies that ship or walk."""

import numpy as np
import pytest

from renet.bundle import pretrained
from renet.errors import RenetError
from renet.evaluation.studies.backing import BackingStudy, outcomes

from .test_stops import StillEvaluator

DRIVEN = pretrained("go1-driven")


def test_outcomes_are_those_of_the_first_try():
    # Ends far enough; falls before; falls after; stands; is put back after a fall, and goes on.
    positions = np.array(
        [
            [0.8, 0.8, 0.8, 0.8, 0.8],
            [0.3, 0.5, -0.3, 0.8, 0.8],
            [-0.2, 0.8, 0.8, 0.8, -0.5],
        ]
    )
    ended = np.zeros((3, 5), bool)
    ended[1, 1] = ended[2, 2] = ended[1, 4] = True
    backed, fell = outcomes(positions, ended)
    assert backed.tolist() == [True, False, True, False, False]
    assert fell.tolist() == [False, True, False, False, True]


def test_a_robot_that_stands_neither_backs_out_nor_falls(tmp_path):
    study = BackingStudy(
        tmp_path,
        bundle=DRIVEN,
        quick=True,
        seconds=1.0,
        kinds=("stairs_up",),
        conditions="nominal",
    )
    (run,) = study.run(StillEvaluator(DRIVEN, conditions="nominal"))["runs"]
    assert (run["backed"], run["falls"], run["robots"]) == (0, 0, 6)


def test_a_policy_that_can_be_driven_backs_out(tmp_path):
    study = BackingStudy(tmp_path, bundle=DRIVEN, quick=True, kinds=("gap",), conditions="nominal")
    (run,) = study.run()["runs"]
    assert run["backed"] >= 4
    assert run["success_rate"] == run["backed"] / run["robots"]


def test_a_policy_that_is_told_headings_is_refused(tmp_path):
    with pytest.raises(RenetError, match="cannot be asked to walk backward"):
        BackingStudy(tmp_path, quick=True, kinds=("gap",)).run()
