from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from renet.evaluation.studies.fault_pairs import beyond_chance, paired_runs, sign_test

MODES = ("vp", "renet", "op")


def test_twins_and_op_are_matched_robot_by_robot() -> None:
    # One severity, three modes, four robots.
    fell = [1, 1, 0, 0, 0, 1, 0, 0, 1, 0, 1, 0]
    calm = [1, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0]
    runs = [{"mode": mode} for mode in MODES]
    vp, renet, op = paired_runs({"runs": runs, "fell": fell}, {"fell": calm}, MODES, 4)
    assert (vp["falls_by_fault"], vp["falls_spared"]) == (1, 1)
    assert (renet["falls_by_fault"], renet["falls_spared"]) == (1, 0)
    assert (op["falls_by_fault"], op["over_op"]) == (2, None)
    # Robot 1 stays up only with OP, robots 0 and 2 only with RENet.
    assert (renet["only_op_upright"], renet["only_renet_upright"]) == (1, 2)
    assert renet["over_op"] == pytest.approx(0.25)
    assert -1.0 <= renet["over_op_ci95_low"] < 0.25 < renet["over_op_ci95_high"] <= 1.0


def test_severities_do_not_mix() -> None:
    fell = np.array([1, 0, 0, 1])  # Two severities, one mode, two robots.
    runs = [{"mode": "vp", "severity": s} for s in (1, 5)]
    rows = paired_runs({"runs": runs, "fell": fell}, {"fell": [0, 0, 0, 1]}, ("vp",), 2)
    assert [(r["falls_by_fault"], r["falls_spared"]) for r in rows] == [(1, 0), (0, 0)]


@pytest.mark.parametrize(
    ("more", "fewer", "chance"), [(5, 0, 1 / 32), (4, 0, 1 / 16), (7, 8, 0.6963806), (0, 0, 1.0)]
)
def test_the_sign_test_is_the_textbooks(more: int, fewer: int, chance: float) -> None:
    assert sign_test(more, fewer) == pytest.approx(chance)


@given(st.integers(0, 30), st.integers(0, 30))
def test_heads_or_tails(more: int, fewer: int) -> None:
    both = sign_test(more, fewer) + sign_test(fewer, more)
    tie = sign_test(more, fewer) - sign_test(more + 1, fewer - 1) if fewer else sign_test(more, 0)
    assert both == pytest.approx(1.0 + tie)


def test_where_nothing_ever_happens_once_is_enough() -> None:
    assert beyond_chance([(1, 0)], calm=True)
    assert not beyond_chance([(1, 0)], calm=False)
    assert not beyond_chance([(1, 1)], calm=True)
    assert beyond_chance([(3, 0), (2, 0)], calm=False)
    assert not beyond_chance([], calm=True)
