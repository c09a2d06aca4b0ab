"""The page about measuring agrees with the study and with its faults."""

import re
from pathlib import Path

import pytest

from renet.evaluation.studies import fault_settings
from renet.evaluation.studies.fault_metrics import robot_measures
from renet.evaluation.trace import Trace
from renet.faults import FAULTS

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


@pytest.mark.parametrize(
    "name", ["edge_shadow", "disparity_steps", "textureless", "tall_grass", "intermittent_glare"]
)
def test_the_page_states_the_catalogues_levels(name: str) -> None:
    listed = PAGE.split(f"- `{name.split('_glare')[0]}")[1].split("\n- ")[0]
    numbers = [float(n) for n in re.findall(r"\d+(?:\.\d+)?", re.sub(r" \(D435i\)", "", listed))]
    percent = FAULTS[name].unit == "share"
    levels = [100 * n if percent else n for n in FAULTS[name].levels]
    fives = [numbers[k : k + 5] for k in range(len(numbers) - 4)]
    assert any(five == pytest.approx(levels) for five in fives), numbers
