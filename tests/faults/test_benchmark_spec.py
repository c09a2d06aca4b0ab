"""The benchmark's specification agrees with its schema and with the catalogue of faults."""

import json
import re
from collections.abc import Callable
from copy import deepcopy
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator

from renet.faults import FAULTS

DOCS = Path(__file__).parents[2] / "docs"
SPECIFICATION = (DOCS / "benchmark.md").read_text()
SCHEMA = json.loads((DOCS / "benchmark.schema.json").read_text())
MEASURES = SCHEMA["$defs"]["setting"]["properties"]["measures"]


def result() -> dict[str, Any]:
    share = {"value": 0.5, "ci95": [0.3, 0.7], "change": {"value": -0.5, "ci95": [-0.7, -0.3]}}
    untaken = {"value": None, "ci95": None, "change": {"value": None, "ci95": None}}
    setting = {"ground": "gap", "level": 4, "fault": "glare", "severity": 3, "mode": "vp"}
    measures = {name: deepcopy(untaken) for name in MEASURES["required"]} | {"crossed": share}
    return {
        "benchmark": "renet-faults",
        "version": 1,
        "policy": {"name": "theirs", "url": None, "sha256": "0" * 64, "modes": ["vp"]},
        "provenance": {
            "renet": "1",
            "commit": None,
            "engine": "native",
            "command": "run",
            "date": "2026-01-01",
        },
        "protocol": {"robots": 20, "seed": 1, "speed": 0.6, "quick": False},
        "settings": [setting | {"onset": "before_the_edge", "measures": measures}],
    }


def test_a_complete_result_is_valid() -> None:
    Draft202012Validator.check_schema(SCHEMA)
    Draft202012Validator(SCHEMA).validate(result())


@pytest.mark.parametrize(
    "spoil",
    [
        lambda r: r.update(version=2),
        lambda r: r.update(settings=[]),
        lambda r: r["policy"].update(sha256="unknown"),
        lambda r: r["settings"][0].update(severity=6),
        lambda r: r["settings"][0].pop("onset"),
        lambda r: r["settings"][0]["measures"].pop("switches"),
        lambda r: r["settings"][0]["measures"]["crossed"].update(value=1.2),
        lambda r: r["settings"][0]["measures"]["crossed"].pop("ci95"),
        lambda r: r["settings"][0]["measures"]["crossed"]["change"].update(ci95=[0.1]),
    ],
)
def test_a_result_that_lacks_or_breaks_something_is_not(spoil: Callable) -> None:
    broken = result()
    spoil(broken)
    assert list(Draft202012Validator(SCHEMA).iter_errors(broken))


def test_specification_lists_every_fault_once() -> None:
    table = SPECIFICATION.split("| group | faults |")[1].split("\n\n")[0]
    assert sorted(re.findall(r"`([a-z_]+)`", table)) == sorted(FAULTS)


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
    assert any(numbers[k : k + 5] == pytest.approx(levels) for k in range(len(numbers) - 4)), (
        numbers
    )
