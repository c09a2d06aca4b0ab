"""The benchmark's specification agrees with its schema and with its faults."""

import re
from pathlib import Path

import pytest

from renet.evaluation.studies import benchmark
from renet.faults import FAULTS

SPECIFICATION = (Path(__file__).parents[2] / "docs" / "benchmark.md").read_text()
SCHEMA = benchmark.schema(1)
MEASURES = SCHEMA["$defs"]["setting"]["properties"]["measures"]


def test_specification_lists_every_fault_once() -> None:
    table = SPECIFICATION.split("| group | faults |")[1].split("\n\n")[0]
    assert sorted(re.findall(r"`([a-z_]+)`", table)) == sorted(benchmark.LISTED)


def test_specification_and_schema_name_the_same_measures_grounds_and_onsets() -> None:
    def named(first: str) -> set[str]:
        table = SPECIFICATION.split(first)[1].split("\n\n")[0]
        cells = [row.split("|")[1] for row in table.splitlines() if row.count("|") > 2]
        return set(re.findall(r"`([a-z_]+)`", " ".join(cells)))

    setting = SCHEMA["$defs"]["setting"]["properties"]
    assert named("| name | unit | of one robot |") == set(MEASURES["required"])
    assert named("| ground | level | why |") == set(setting["ground"]["enum"])
    assert named("| name | when |") == set(setting["onset"]["enum"])


@pytest.mark.parametrize(
    "name", ["edge_shadow", "disparity_steps", "textureless", "tall_grass", "intermittent_glare"]
)
def test_specification_states_the_catalogues_levels(name: str) -> None:
    listed = SPECIFICATION.split(f"- `{name.split('_glare')[0]}")[1].split("\n- ")[0]
    numbers = [float(n) for n in re.findall(r"\d+(?:\.\d+)?", re.sub(r" \(D435i\)", "", listed))]
    percent = FAULTS[name].unit == "share"
    levels = [100 * n if percent else n for n in FAULTS[name].levels]
    fives = [numbers[k : k + 5] for k in range(len(numbers) - 4)]
    assert any(five == pytest.approx(levels) for five in fives), numbers
