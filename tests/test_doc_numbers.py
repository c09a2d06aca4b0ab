"""Tables of the documents: each number is the one in the result file that the page links."""

import json
import re
import shutil
import statistics
from pathlib import Path

import pytest

import tables

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results"


def cells(page: str, heading: str) -> list[list[str]]:
    """The rows of the tables of a section, of a file in the repository."""
    text = re.sub(r"```.*?```", "", (ROOT / page).read_text(), flags=re.DOTALL)
    section = re.split(rf"^#+ {heading}$", text, flags=re.MULTILINE)[1]
    section = re.split(r"^#", section, flags=re.MULTILINE)[0]
    lines = re.findall(r"^\| (.+) \|$", section, re.MULTILINE)
    return [[cell.strip() for cell in line.split(" | ")] for line in lines]


def result(name: str) -> dict:
    return json.loads((RESULTS / name).read_text())


@pytest.mark.parametrize("path", sorted(RESULTS.glob("table1/*.json")), ids=lambda path: path.stem)
def test_row_of_table_1(path):
    row = json.loads(path.read_text())
    seeds = len(list(path.parent.glob(f"{path.stem[:-2]}_*.json")))
    name = row["row"].replace("SA", "SA (RENet)") if row["seed"] == 1 else row["row"]
    title = f"{name}, {row['seed']}" if seeds > 1 else name
    passed = {kind: 0 for kind in ("gap", "platform", "stairs")}
    for run in row["runs"]:
        passed[run["kind"].split("_")[0]] += run["passed"]
    shown = next(line for line in cells("benchmarks/NOTES.md", "Table I") if line[0] == title)
    assert [int(n.strip("*")) for n in shown[1:4]] == list(passed.values())
    assert float(shown[4].strip("*")) == pytest.approx(row["collisions"], abs=0.00501)


def test_bold_cells_of_table_1_lie_outside_its_prediction_intervals():
    lines = [line for line in cells("benchmarks/NOTES.md", "Table I") if len(line) == 5][1:]
    seeds, others = lines[:4], {line[0]: line[1:] for line in lines[5:]}
    for column in range(1, 5):
        values = [float(line[column]) for line in seeds]
        # Student's t with three degrees of freedom, for the mean of four and one value more.
        reach = 3.182446 * statistics.stdev(values) * (1 + 1 / 4) ** 0.5
        ends = [statistics.mean(values) + sign * reach for sign in (-1, 1)]
        shown = [float(end) for end in lines[4][column].strip("*").split(" to ")]
        assert shown == pytest.approx(ends, abs=0.501 if column < 4 else 0.0151)
        outside = {
            row
            for row, numbers in others.items()
            if not ends[0] <= float(numbers[column - 1].strip("*")) <= ends[1]
        }
        assert outside == {row for row, n in others.items() if n[column - 1].startswith("**")}


def test_tables_of_the_shipped_policy_are_those_of_its_results(tmp_path, capsys):
    assert tables.main([]) == 0
    for name in {name for name, _ in [*tables.TABLES, *tables.LEADERBOARDS, *tables.SENTENCES]}:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    page = tmp_path / "docs" / "memory.md"
    right = page.read_text()
    page.write_text(right.replace("| memory | 20 |", "| memory | 17 |"))
    assert page.read_text() != right
    assert tables.main([], tmp_path) == 1
    assert "docs/memory.md, Measure it" in capsys.readouterr().out
    assert tables.main(["--fill"], tmp_path) == 0
    assert page.read_text() == right


def test_counts_in_a_sentence_are_filled(monkeypatch):
    crossed = {"switch": 3, "memory": 24}
    monkeypatch.setattr(tables, "result", lambda name: {"crossed": crossed, "seeds": 25})
    old = "[0 of 9](x/first_walk.json) cross with\n`switch`, [1 of 9](x/first_walk.json) `memory`"
    new = old.replace("0 of 9", "3 of 25").replace("1 of 9", "24 of 25")
    assert tables.first_walk(old) == new
    other = "[1 of 9](results/other.json) with `memory`"
    assert tables.first_walk(other) == other


def test_the_first_commands_are_those_that_were_walked():
    walks = result("first_walk.json")
    readme = (ROOT / "README.md").read_text()
    assert tables.first_walk(readme.replace(" of 25](", " of 26](")) == readme, "it has the counts"
    for mode in walks["crossed"]:
        assert f"{walks['command_of_the_readme']} --mode {mode} " in readme
    assert walks["seeds"] == len({run["seed"] for run in walks["runs"]})


def test_what_two_seconds_without_an_image_cost():
    lost = {
        run["ground"]: tuple(
            -round(100 * run[f"change{end}"]) for end in ("", "_ci95_high", "_ci95_low")
        )
        for run in result("shipped/two_seconds.json")["runs"]
        if run["without_s"] == 2
    }
    names, costs = cells("benchmarks/NOTES.md", r"How much do seconds without an image cost\?")[-2:]
    shown = [tuple(map(int, re.findall(r"-?\d+", cost.replace("−", "-")))) for cost in costs]
    assert dict(zip(names, shown, strict=True)) == {
        ground.replace("_", " "): points for ground, points in lost.items()
    }


def test_motors_of_the_go2():
    content = result("go2/motors.json")
    error = content["evidence"]["standard_error"]
    rmse = content["evidence"]["rmse_rad"]["held_out"]
    lines = cells("benchmarks/NOTES.md", "A Go2's motors")
    columns = {"armature": (1, 4), "damping": (1, 2), "friction": (1, 2), "delay": (1000, 1)}
    for kind, motor in content["motors"].items():
        (shown,) = (line[1:] for line in lines if line[0] == kind)
        for cell, (name, (unit, digits)) in zip(shown, columns.items(), strict=True):
            value, uncertain = motor[name], error[kind][name]
            text = f"{unit * value:.{digits}f}"
            assert cell == (
                text if uncertain is None else f"{text} ± {unit * uncertain:.{digits}f}"
            )
    titles = {"all rows": "all", "hips": "hip", "thighs": "thigh", "calves": "calf"}
    titles["where no target is beyond a limit"] = "within_limits"
    for title, name in titles.items():
        (shown,) = (line[1:] for line in lines if line[0] == title)
        assert shown == [f"{rmse[model][name]:.4f}" for model in ("described", "measured")]


def test_the_outside_referee():
    lines = {line[0]: line[1:] for line in cells("docs/benchmark.md", "An outside referee")}
    stairs = result("referee/stairs.json")["policies"]
    for policy, name in (
        ("go2-parkour, blind", "renet"),
        ("RoboGauge's mixture of experts", "moe"),
    ):
        flat, level = lines[policy]
        score = result(f"referee/{name}_flat.json")["results"]["scores"]["flat"]
        assert float(flat) == pytest.approx(score, abs=0.00051)
        reached = {
            int(of): int(n.split()[0]) for of, n in stairs[name]["seeds_at_the_target"].items()
        }
        passed = max(of for of, seeds in reached.items() if seeds >= 4)
        assert int(re.search(r"level (\d+)", level)[1]) == passed
    flat, level = lines["go2-driven, blind"]
    driven = result("referee/renet_driven.json")["results"]
    assert float(flat) == pytest.approx(driven["scores"]["flat"], abs=0.00051)
    # RoboGauge names a score by the highest level that is passed.
    passed = re.search(r"level (\d+)", level)[1]
    assert f"stairs_fd_{passed}_baseMass0_friction0.6" in driven
