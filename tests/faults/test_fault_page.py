"""The page about measuring agrees with the study and with its faults."""

import re
from pathlib import Path

from renet.evaluation.studies import fault_settings
from renet.evaluation.studies.fault_metrics import robot_measures
from renet.evaluation.trace import Trace

PAGE = (Path(__file__).parents[2] / "docs" / "measure.md").read_text()


def test_the_page_lists_every_fault_once() -> None:
    table = PAGE.split("| group | faults |")[1].split("\n\n")[0]
    assert sorted(re.findall(r"`([a-z_]+)`", table)) == sorted(fault_settings.LISTED)


def test_page_and_study_name_the_same_measures_grounds_and_onsets() -> None:
    def named(first: str) -> set[str]:
        table = PAGE.split(first)[1].split("\n\n")[0]
        cells = [row.split("|")[1] for row in table.splitlines() if row.count("|") > 2]
        return set(re.findall(r"`([a-z_]+)`", " ".join(cells)))

    measured = robot_measures(Trace.empty(5, 1), 1, 0.6, 5)
    assert named("| name | unit | of one robot |") == {*measured}
    assert named("| ground | level | what vision is for |") == {*fault_settings.FAULT_GROUNDS}
    assert named("| name | onset |") == {*fault_settings.ONSETS.values()}
