"""Hold the documents' numbers of results to the files of these results.

    python tools/tables.py           name the pages that differ from their results; exit code 1
    python tools/tables.py --fill    write their numbers

The first cell of a table's row says what the row is about; the others are filled. Rows are neither
added nor removed, except those of the leaderboard. Of a sentence only the numbers are filled.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from renet.evaluation.benchmark.leaderboard import ranking
from renet.evaluation.benchmark.results import read_result, rows_of_entry
from renet.evaluation.benchmark.scores import crossed_shares
from renet.evaluation.metrics import bootstrap_interval
from renet.evaluation.results import column

ROOT = Path(__file__).parent.parent
RESULTS = ROOT / "benchmarks" / "results"
GROUNDS = ("flat", "stairs_up", "stairs_down", "obstacles", "platform", "gap")
SWITCHES = (
    ("severity_5", "camera"),
    ("severity_5", "memory"),
    ("severity_5_rules", "switch"),
    ("severity_5_rules", "oracle"),
    ("severity_5_gate", "memory"),
    ("severity_5_return", "memory"),
    ("severity_5", "blind"),
)
"""Studies and modes of the table of switches, column by column."""
LEADERBOARD = (
    "go1-parkour",
    "oracle_withholds",
    "go2-parkour",
    "playground",
    "himloco",
    "robot-lab",
    "robogauge",
)
"""Result files of the fault benchmark's leaderboard, the reference first."""
JUDGES = ("go1-parkour", "oracle", "oracle_withholds", "gate", "gate_withholds", "return")
"""Result files of the leaderboard of one policy with the switches of other judges."""


@cache
def result(name: str) -> Any:
    """A result file of the policy that ships."""
    return json.loads((RESULTS / "shipped" / f"{name}.json").read_text())


def mean(study: str, mode: str, grounds: tuple[str, ...], measure: str = "crossed") -> str:
    """A mode's mean over a study's settings on some grounds, per cent."""
    shares = [
        row["measures"][measure]["value"]
        for row in result(study)["runs"]
        if row["mode"] == mode and row["ground"] in grounds
    ]
    return f"{100 * np.mean(shares):.1f}"


def crossed(label: str, study: str) -> list[str]:
    """Modes camera, memory and blind under single faults, per cent, by ground, and the lead."""
    grounds = GROUNDS[1:] if label == "all but flat" else (label.replace(" ", "_"),)
    means = [mean(study, mode, grounds) for mode in ("camera", "memory", "blind")]
    return [*means, ahead(study, grounds).replace("-", "−")]


def ahead(study: str, grounds: tuple[str, ...]) -> str:
    """Points that memory crosses more than camera on some grounds, with the 95 % interval."""
    vp, renet = (result(study)["by_robot"][mode] for mode in ("camera", "memory"))
    settings = [row["ground"] for row in result(study)["runs"] if row["mode"] == "camera"]
    gains = [np.subtract(renet[name]["crossed"], vp[name]["crossed"]) for name in grounds]
    gain = np.average(gains, axis=0, weights=[settings.count(name) for name in grounds])
    low, high = bootstrap_interval(100 * gain)
    return f"{100 * gain.mean():+.1f} ({low:+.1f} to {high:+.1f})"


def lead(study: str, mode: str) -> tuple[str, str]:
    """Points that memory crosses more in the 143 settings, and the 95 % interval over robots."""
    ours, theirs = result("severity_5")["by_robot"]["memory"], result(study)["by_robot"][mode]
    grounds = GROUNDS[1:]
    gains = [np.subtract(ours[name]["crossed"], theirs[name]["crossed"]) for name in grounds]
    rows = [row["ground"] for row in result(study)["runs"] if row["mode"] == mode]
    gain = 100 * np.average(gains, axis=0, weights=[rows.count(name) for name in grounds])
    low, high = bootstrap_interval(gain)
    return (f"{gain.mean():.1f}", f"{low:.1f} to {high:.1f}") if gain.any() else ("–", "–")


def switches(label: str) -> list[str]:
    """Every switch of the same two estimators at severity 5, per cent, by ground."""
    if label in ("lead of memory", "its interval"):
        return [lead(study, mode)[label == "its interval"] for study, mode in SWITCHES]
    grounds = GROUNDS[1:] if label.startswith("all") else (label.replace(" ", "_"),)
    measure = "upright" if label.endswith("upright") else "crossed"
    return [mean(study, mode, grounds, measure) for study, mode in SWITCHES]


def grass(label: str) -> list[str]:
    """How many robots' images are withheld among so many blades, by ground."""
    severity = 1 + ("8", "20", "45", "90", "180").index(label.split(", ")[0])
    runs = [run for run in result("grass")["runs"] if run["severity"] == severity]
    return [str(sum(r["detected"] for r in runs if r["ground"] == ground)) for ground in GROUNDS]


def standing(label: str) -> list[str]:
    """Robots that stand still, with VP and with OP, on each ground of the label."""
    still = {(run["kind"], run["mode"]): str(run["still"]) for run in result("standing")["runs"]}
    kinds = [kind.replace(" ", "_") for kind in label.split(", ")]
    return [", ".join(still[kind, mode] for kind in kinds) for mode in ("camera", "blind")]


def kilometre(label: str) -> list[str]:
    """Kilometres, falls, and falls per kilometre of the long walk."""
    total = kilometre_summary()["totals"][label]
    interval = f"{total['ci95_low']:.1f} to {total['ci95_high']:.1f}"
    rate = f"{total['falls_per_km']:.1f} ({interval})"
    return [f"{total['metres'] / 1000:.2f}", str(total["falls"]), rate]


def lead_of_memory(other: str) -> list[str]:
    """Points of memory less another mode: crossed under loud faults, lies, by strangers; falls."""
    path = RESULTS / "benchmark" / "full" / "go1-parkour.json"
    ours, theirs = (rows_of_entry(read_result(path), name) for name in ("memory", other))
    gain = crossed_shares(ours) - crossed_shares(theirs)
    falls = np.subtract(column(ours, "fell"), column(theirs, "fell"), dtype=float)
    lie = np.array(column(ours, "lie"))
    stranger = np.array(column(ours, "stranger"))
    cells = []
    for points in (gain[~lie], gain[lie], gain[stranger], falls):
        low, high = bootstrap_interval(100 * points)
        text = f"{100 * points.mean():+.1f} ({low:+.1f} to {high:+.1f})"
        cells.append(text.replace("-", "−"))
    return cells


def loudness(mode: str) -> list[str]:
    """The cells of a mode, %: crossed under loud faults, under lies, by strangers; falls."""
    path = RESULTS / "benchmark" / "full" / "go1-parkour.json"
    score = read_result(path)["scores"][mode]
    return [f"{100 * score[name]:.1f}" for name in ("loud", "lies", "stranger", "falls")]


def sections(label: str) -> list[str]:
    """How many walks over a section of the long walk ended in a fall or stuck, by mode."""
    ends = kilometre_summary()["sections"][label]
    return [str(of["fell"] + of["stuck"]) for of in ends.values()]


@cache
def kilometre_summary() -> Any:
    """The summary of the long walk."""
    return json.loads((RESULTS / "benchmark" / "kilometre.json").read_text())


def black(label: str, studies: tuple[str, ...] = ("blackout_on_the_way", "blackout")) -> list[str]:
    """Who crosses with a black camera, from 1.5 s and from 0.5 s before the edge on."""
    counts = []
    for name in studies:
        seconds = 0 if label in ("blind", "healthy camera") else 6
        mode = "memory" if label == "healthy camera" else label
        runs = [r for r in result(name)["runs"] if (r["mode"], r["without_s"]) == (mode, seconds)]
        counts.append([str(run["crossed"]) for run in runs])
    if label in ("blind", "healthy camera"):  # When the camera fails is nothing to them.
        return counts[0]
    return [" / ".join(pair) for pair in zip(*counts, strict=True)]


def reach(label: str) -> list[str]:
    """Robots over a gap, fallen into it and standing before it, when they walk on, or stop."""
    runs = [run for run in result("reach")["runs"] if run["scene"] == "two gaps"]
    conducts = ("walk", "stop")
    if label == "of them at the second gap":
        ends = {run["unseen"]: (run["fell_at_second"], run["stood_behind"]) for run in runs}
        return ["{} fall, {} stand".format(*ends[conduct]) for conduct in conducts]
    if label != "before two gaps":
        metres = float(label.split(" m ")[0])
        runs = [
            run
            for run in result("reach")["runs"]
            if run["scene"] == "gap" and run["metres"] == metres
        ]
    cells = {}
    for run in runs:
        fell = run["fell"] - run["fell_at_second"]
        over = run["robots"] - fell - run["stood_before"]
        cells[run["unseen"]] = f"{over} / {fell} / {run['stood_before']}"
    return [cells[conduct] for conduct in conducts]


def one_try(_label: str) -> list[str]:
    """Who of 100 crosses the largest obstacles with one try."""
    rows = result("success_100")["runs"]
    passed = {run["kind"]: str(run["passed"]) for run in rows if run["level"] == 10}
    return [passed[kind] for kind in ("gap", "platform", "stairs_up", "stairs_down")]


def go2(label: str) -> list[str]:
    """Which Go2s of 20 cross with one try, size by size."""
    mode = {"with vision": "camera", "without": "blind"}[label]
    rows = [run for run in result("../go2/success")["runs"] if run["mode"] == mode]
    passed = {(run["kind"], run["level"]): str(run["passed"]) for run in rows}
    sizes = {"gap": (4, 6, 8, 10), "platform": (6, 8, 10), "stairs_up": (8, 10)}
    sizes |= {"stairs_down": sizes["stairs_up"]}
    return [", ".join(passed[kind, level] for level in sizes[kind]) for kind in sizes]


NOMINAL = (("commands", "camera"), ("commands", "blind"))
GO2_NOMINAL = (("go2_commands", "camera"), ("go2_commands", "blind"))
"""Study and mode of each column of velocities."""


def driven(
    label: str,
    studies: Sequence[tuple[str, str]] = (*NOMINAL, ("commands_training", "camera")),
) -> list[str]:
    """What robots did of a command in each of some studies, and how many fell."""
    command = [float(number.replace("−", "-")) for number in label.split(", ")]
    cells = []
    for study, mode in studies:
        runs = runs_of(f"driving/{study}")
        (run,) = [run for run in runs if run["command"] == command and run["mode"] == mode]
        done = ", ".join(f"{number:.2f}" for number in run["done"])
        done = done.replace("-0.00", "0.00").replace("-", "−")
        falls = run["falls"]
        cells.append(f"{done} ({falls} fell)" if falls else done)
    return cells


def driven_over(label: str) -> list[str]:
    """Who of 20 crosses with one try, by policy and motors."""
    files = {
        "go1-driven, ideal": "success",
        "go1-driven, ideal, told 1 m/s": "success_fast",
        "go1-parkour, ideal": "success_parkour",
        "go1-driven, a Go1's": "success_go1",
        "go1-parkour, a Go1's": "success_go1_parkour",
        "go2-driven": "go2_success",
        "go2-driven, told 1 m/s": "go2_success_fast",
        "go2-parkour": "go2_success_parkour",
    }
    file = files[label.replace("`", "")]
    passed = {}
    for run in runs_of(f"driving/{file}"):
        passed[run["kind"], run["level"]] = str(run["passed"])
    columns = [("gap", 8), ("gap", 10), ("platform", 10), ("stairs_up", 10), ("stairs_down", 10)]
    return [passed[column] for column in columns]


def driven_without_camera(label: str) -> list[str]:
    """Who of 20 crosses a gap if the camera is unplugged half a second before, by mode."""
    level = {"43 cm": 6, "57 cm": 8}[label]
    runs = runs_of("driving/gap_dead")
    passed = {run["mode"]: str(run["passed"]) for run in runs if run["level"] == level}
    return [passed[mode] for mode in ("camera", "switch", "blind", "memory")]


def driven_to_edges(label: str) -> list[str]:
    """Who of 20 falls at a barrier, or does not get away from an edge."""
    if label.startswith("backward from "):
        kinds = label.removeprefix("backward from ").replace("stairs ", "stairs_").split(", ")
        stuck = {
            (run["kind"], run["mode"]): str(run["robots"] - run["backed"])
            for run in runs_of("driving/backing")
        }
        cells = [
            f"{', '.join(stuck[kind, mode] for kind in kinds)} ({mode})"
            for mode in ("memory", "blind")
        ]
        return [", ".join(cells)]
    kind, *angles = re.fullmatch(r"ahead at a (\w+), (\d+)°, (\d+)°", label).groups()
    stops = [run for run in runs_of("driving/stops") if run["mode"] == "camera"]
    falls = {(run["kind"], run["angle_deg"]): str(run["falls"]) for run in stops}
    return [f"{', '.join(falls[kind, float(angle)] for angle in angles)} (camera)"]


def driven_lies(label: str) -> list[str]:
    """Shares that cross with a camera that lies: camera, memory without and with surprise."""
    name = label.strip("`")
    (run,) = [run for run in runs_of("driving/lies") if run["fault"] == name]
    modes = ("camera", "memory_without", "memory_with")
    return [f"{100 * run[mode]:.0f}" for mode in modes]


def runs_of(name: str) -> list[dict[str, Any]]:
    """The rows of a study in benchmarks/results."""
    return json.loads((RESULTS / f"{name}.json").read_text())["runs"]


TABLES: dict[tuple[str, str], Callable[[str], list[str]]] = {
    ("docs/results.md", "Obstacles"): one_try,
    ("docs/results.md", "Grass"): grass,
    ("docs/results.md", "Other switches"): switches,
    ("docs/results.md", "Standing"): standing,
    ("docs/results.md", "Driven on flat ground"): partial(driven, studies=NOMINAL),
    ("docs/results.md", "Driven over obstacles"): driven_over,
    ("docs/results.md", "Driven without a camera"): driven_without_camera,
    ("docs/results.md", "Driven to edges"): driven_to_edges,
    ("docs/memory.md", "Where memory ends"): reach,
    ("docs/memory.md", "Measure it"): partial(black, studies=("blackout",)),
    ("docs/results.md", "Go2, one try"): go2,
    ("docs/results.md", "Go2, driven on flat ground"): partial(driven, studies=GO2_NOMINAL),
    ("docs/results.md", "Go2, driven over obstacles"): driven_over,
    ("docs/results.md", "Go2, black images"): partial(black, studies=("../go2/blackout",)),
    ("docs/results.md", "Go2, single faults"): partial(crossed, study="../go2/severity_5"),
    ("docs/benchmark.md", "The lead of memory"): lead_of_memory,
    ("docs/benchmark.md", "The kilometre"): kilometre,
    ("benchmarks/NOTES.md", "How much do seconds without an image cost\\?"): black,
    ("benchmarks/NOTES.md", "The kilometre"): sections,
    ("benchmarks/NOTES.md", "Loud faults and lies"): loudness,
    ("benchmarks/NOTES.md", "Velocities asked for and done"): driven,
    ("benchmarks/NOTES.md", "Lies, fault by fault"): driven_lies,
    ("benchmarks/NOTES.md", "Other switches, ground by ground"): switches,
}
"""What fills the cells of a row, given its first one, by file and heading of its table."""

LEADERBOARDS: dict[tuple[str, str], tuple[str, ...]] = {
    ("docs/benchmark.md", "Results"): LEADERBOARD,
    ("benchmarks/NOTES.md", "Judges on the benchmark"): JUDGES,
}
"""Result files of the leaderboards, by file and heading; all their rows are new."""


def first_walk(page: str) -> str:
    """Fill a page's counts of walks that cross, each a link with the mode after it."""
    walks = result("../first_walk")

    def count(link: re.Match[str]) -> str:
        return f"[{walks['crossed'][link['mode']]} of {walks['seeds']}]{link['rest']}"

    counts = r"\[\d+ of \d+\](?P<rest>\(\S+/first_walk\.json\)[^`]*`(?P<mode>\w+)`)"
    return re.sub(counts, count, page)


SENTENCES: dict[tuple[str, str], Callable[[str], str]] = {
    ("README.md", "the first commands with other seeds"): first_walk,
}
"""Functions that fill the numbers in a page's sentences, by file and subject."""


def leaderboard(_labels: list[str], names: tuple[str, ...]) -> list[list[str]]:
    """The rows of a leaderboard of the fault benchmark, best first."""
    files = [RESULTS / "benchmark" / "full" / f"{name}.json" for name in names]
    rows = []
    for _, policy, entry, _, score, interval, _, behind in ranking(
        [read_result(file) for file in files]
    )[2]:
        rows.append([policy, entry, f"{score} ({interval})", behind.replace("-", "−")])
    return rows


def refilled(labels: list[str], fill: Callable[[str], list[str]]) -> list[list[str]]:
    """The rows of a table, from their first cells."""
    return [[label, *fill(label)] for label in labels]


def filled(page: str, heading: str, make_rows: Callable[[list[str]], list[list[str]]]) -> str:
    """A page with new rows, made from the labels of the old ones, in a heading's first table."""
    text = page.split("\n")
    below = next(i for i, line in enumerate(text) if re.fullmatch(rf"#+ {heading}", line))
    top = next(i for i in range(below, len(text)) if text[i].startswith("|---")) + 1
    end = next(i for i in range(top, len(text)) if not text[i].startswith("|"))
    labels = [line.strip("| ").split(" | ")[0] for line in text[top:end]]
    rows = [f"| {' | '.join(row)} |" for row in make_rows(labels)]
    return "\n".join([*text[:top], *rows, *text[end:]])


def main(arguments: list[str], root: Path = ROOT) -> int:
    """Compare or fill; 1 if a page differs from its results and is not to be filled."""
    fillers: dict[tuple[str, str], Callable[[str], str]] = {}
    for (name, heading), fill in TABLES.items():
        make_rows = partial(refilled, fill=fill)
        fillers[name, heading] = partial(filled, heading=heading, make_rows=make_rows)
    for (name, heading), names in LEADERBOARDS.items():
        make_rows = partial(leaderboard, names=names)
        fillers[name, heading] = partial(filled, heading=heading, make_rows=make_rows)
    fillers |= SENTENCES
    wrong = 0
    for (name, subject), fill_page in fillers.items():
        page = (root / name).read_text()
        new = fill_page(page)
        if "--fill" in arguments:
            (root / name).write_text(new)
        elif new != page:
            print(f"{name}, {subject}: other numbers than its results; run tools/tables.py --fill")
            wrong = 1
    return wrong


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
