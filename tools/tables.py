"""Hold the documents' tables about the policy that ships to the files of its results.

    python tools/tables.py           name the rows that differ from their results; exit code 1
    python tools/tables.py --fill    write them

The first cell of a row says what the row is about; the others are filled. Rows are neither added
nor removed, except those of a leaderboard.
"""

from __future__ import annotations

import json
import math
import re
import sys
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from renet.evaluation.metrics import bootstrap_interval
from renet.evaluation.studies.benchmark import read_result
from renet.evaluation.studies.crossing import ranking
from renet.evaluation.studies.leaderboard import paired

ROOT = Path(__file__).parent.parent
RESULTS = ROOT / "benchmarks" / "results"
GROUNDS = ("flat", "stairs_up", "stairs_down", "obstacles", "platform", "gap")
MODES = {
    "VP alone": "camera",
    "VP on black images": "camera",
    "RENet": "memory",
    "OP alone": "blind",
    "OP": "blind",
    "switch that knows": "oracle",
}
"""Modes of the studies, by their name in the tables."""
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
LEADERBOARD = ("go1-parkour", "without-memory", "return", "gate", "playground", "cheng-15M")
LEADERBOARD += ("zhuang-15M", "dropout-30M", "renet-30M-seed-2", "renet-30M-seed-3")
FULL_RUN = ("full", "full-paper")


@cache
def result(name: str) -> Any:
    """A result file of the policy that ships."""
    return json.loads((RESULTS / "shipped" / f"{name}.json").read_text())


def mean(study: str, mode: str, grounds: tuple[str, ...], measure: str = "crossed") -> str:
    """A mode's mean over a study's settings on some grounds, per cent."""
    shares = [
        row["measures"][measure]["value"]
        for row in result(study)["settings"]
        if row["mode"] == mode and row["ground"] in grounds
    ]
    return f"{100 * np.mean(shares):.1f}"


def crossed(label: str, study: str = "severity_5") -> list[str]:
    """VP, RENet and OP in the fault benchmark, per cent, and RENet less VP, by ground."""
    grounds = GROUNDS[1:] if label == "all but flat" else (label.replace(" ", "_"),)
    ahead = {ground: cell for ground, cell, _ in paired(result(study))[2]}
    key = "all but the first" if len(grounds) > 1 else grounds[0]
    means = [mean(study, mode, grounds) for mode in ("camera", "memory", "blind")]
    return [*means, ahead[key].replace("-", "−")]


def lead(study: str, mode: str) -> tuple[str, str]:
    """Points that RENet crosses more in the 143 settings, and the 95 % interval over robots."""
    ours, theirs = result("severity_5")["by_robot"]["memory"], result(study)["by_robot"][mode]
    grounds = GROUNDS[1:]
    gains = [np.subtract(ours[name]["crossed"], theirs[name]["crossed"]) for name in grounds]
    rows = [row["ground"] for row in result(study)["settings"] if row["mode"] == mode]
    gain = 100 * np.average(gains, axis=0, weights=[rows.count(name) for name in grounds])
    low, high = bootstrap_interval(gain)
    return (f"{gain.mean():.1f}", f"{low:.1f} to {high:.1f}") if gain.any() else ("–", "–")


def switches(label: str) -> list[str]:
    """Every switch of the same two estimators at severity 5, per cent, by ground."""
    if label in ("RENet's lead", "its interval"):
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
    """How many stand still, with VP and with OP, on each ground of the label."""
    still = {(run["kind"], run["mode"]): str(run["still"]) for run in result("standing")["runs"]}
    kinds = [kind.replace(" ", "_") for kind in label.split(", ")]
    return [", ".join(still[kind, mode] for kind in kinds) for mode in ("camera", "blind")]


def course(label: str) -> list[str]:
    """Kilometres, falls, times stuck and passages of the course."""
    (row,) = (row for row in result("course")["totals"] if row["mode"] == MODES[label])
    kilometres, falls = row["distance_m"] / 1000, str(row["falls"])
    if not row["falls"]:  # The exact limit of Poisson's distribution.
        falls = f"0 (95 % limit {-math.log(0.05) / kilometres:.1f} per km)"
    passages = f"{row['crossed']} of {row['passages']}"
    return [f"{kilometres:.2f} km", falls, str(row["stuck"]), passages]


def black(label: str, studies: tuple[str, ...] = ("blackout_on_the_way", "blackout")) -> list[str]:
    """Who crosses with a black camera, from 1.5 s and from 0.5 s before the edge on."""
    counts = []
    for name in studies:
        seconds = 0 if label in ("OP", "healthy camera") else 6
        mode = MODES.get(label, "memory")
        runs = [r for r in result(name)["runs"] if (r["mode"], r["without_s"]) == (mode, seconds)]
        counts.append([str(run["crossed"]) for run in runs])
    if label in ("OP", "healthy camera"):  # When the camera fails is nothing to them.
        return counts[0]
    return [" / ".join(pair) for pair in zip(*counts, strict=True)]


def one_try(label: str) -> list[str]:
    """Who of 100 crosses with one try, on ground that separates policies."""
    path = {"this policy": "success_100", "the earlier recipe's": "../earlier/success_100"}[label]
    passed = {(run["kind"], run["level"]): str(run["passed"]) for run in result(path)["runs"]}
    return [passed[kind, level] for kind in ("gap", "platform") for level in (8, 10)] + [
        passed[f"stairs_{way}", 10] for way in ("up", "down")
    ]


def go2(label: str) -> list[str]:
    """Which Go2s of 20 cross with one try, size by size."""
    mode = {"with vision": "camera", "without": "blind"}[label]
    rows = [run for run in result("../go2/success")["runs"] if run["mode"] == mode]
    passed = {(run["kind"], run["level"]): str(run["passed"]) for run in rows}
    sizes = {"gap": (4, 6, 8, 10), "platform": (6, 8, 10), "stairs_up": (8, 10)}
    sizes |= {"stairs_down": sizes["stairs_up"]}
    return [", ".join(passed[kind, level] for level in sizes[kind]) for kind in sizes]


def full_run(label: str) -> list[str]:
    """Per cent that cross in version 2's full run, by ground and size."""
    results = [read_result(RESULTS / "leaderboard_2" / f"{name}.json") for name in FULL_RUN]
    settings = [row for result in results for row in result["settings"]]
    ground, _, size = label.replace(" ", "_").partition(",_")
    place = (ground, size) if size else ()
    cells = []
    for mode in ("memory", "camera", "switch", "blind"):
        rows = [row for row in settings if row["mode"] == mode]
        mine = [row for row in rows if place in ((), (row["ground"], row["size"]))]
        robots = results[0]["protocol"]["robots"] * len(mine)
        cells.append(f"{100 * sum(row['crossed'] for row in mine) / robots:.1f}")
    return cells


TABLES: dict[tuple[str, str], Callable[[str], list[str]] | None] = {
    ("pretrained.md", "Obstacles"): one_try,
    ("pretrained.md", "The fault benchmark"): crossed,
    ("pretrained.md", "Grass"): grass,
    ("comparison.md", "At severity 5"): switches,
    ("pretrained.md", "Standing"): standing,
    ("pretrained.md", "A course"): course,
    ("memory.md", "Measure it"): black,
    ("go2.md", "What it can do"): go2,
    ("go2.md", "When its camera fails"): partial(black, studies=("../go2/blackout",)),
    ("go2.md", "The fault benchmark"): partial(crossed, study="../go2/severity_5"),
    ("crossing.md", "Results"): None,
    ("crossing.md", "With the frontier"): full_run,
}
"""What fills the cells of a row, given its first one, by page and heading; the first table counts.
None: a leaderboard, whose rows are all new."""


def leaderboard() -> list[list[str]]:
    """The rows of version 2's leaderboard, best first; of a policy with a switch its switch."""
    files = [RESULTS / "leaderboard_2" / f"{name}.json" for name in LEADERBOARD]
    rows = ranking([read_result(file) for file in files])[2]
    return [[place, name.split(" with ")[-1], *cells] for place, name, *cells in rows]


def filled(page: str, heading: str, fill: Callable[[str], list[str]] | None = None) -> str:
    """A page whose first table under a heading has today's numbers; without `fill` new rows."""
    text = page.split("\n")
    below = next(i for i, line in enumerate(text) if re.fullmatch(rf"#+ {heading}", line))
    top = next(i for i in range(below, len(text)) if text[i].startswith("|---")) + 1
    end = next(i for i in range(top, len(text)) if not text[i].startswith("|"))
    labels = [line.strip("| ").split(" | ")[0] for line in text[top:end]]
    rows = [[label, *fill(label)] for label in labels] if fill else leaderboard()
    return "\n".join([*text[:top], *(f"| {' | '.join(row)} |" for row in rows), *text[end:]])


def main(arguments: list[str], docs: Path = ROOT / "docs") -> int:
    """Compare or fill; 1 if a page differs from its results and is not to be filled."""
    wrong = 0
    for (name, heading), fill in TABLES.items():
        page = (docs / name).read_text()
        new = filled(page, heading, fill)
        if "--fill" in arguments:
            (docs / name).write_text(new)
        elif new != page:
            print(f"{name}, {heading}: other numbers than its results; run tools/tables.py --fill")
            wrong = 1
    return wrong


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
