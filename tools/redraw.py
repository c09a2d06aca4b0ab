"""Draw figures of the documents anew from the results in benchmarks/results: no robot walks.

`python tools/redraw.py` is for a change of names, colours or intervals; benchmarks/shipped.sh and
benchmarks/go2.sh make the results. noise.png cannot be drawn so: its curves are not in the results.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

sys.path.append(str(Path(__file__).parents[1] / "benchmarks"))

from filter import FilterStudy
from renet.evaluation.figures import STYLE, save_figure
from renet.evaluation.metrics import with_share_interval
from renet.evaluation.results import Provenance, select
from renet.evaluation.studies.commands import CommandStudy
from renet.evaluation.studies.faults import crossed_table
from renet.evaluation.studies.margins import MarginsStudy
from renet.evaluation.studies.memory import MemoryStudy
from renet.evaluation.studies.reach import ReachStudy
from renet.evaluation.studies.terrain import TerrainStudy

ROOT = Path(__file__).parent.parent
RESULTS = ROOT / "benchmarks" / "results"
COUNTS = {"memory": ("crossed", "crossed"), "success": ("passed", "success")}
"""Column of a count and name of its share, by kind of figure."""


def memory(summary: dict[str, Any]) -> Figure:
    """Robots that cross, against the seconds without an image."""
    without = tuple(summary["settings"]["without"])
    return MemoryStudy(without=without).draw(summary, {})["memory.png"]


def reach(summary: dict[str, Any]) -> Figure:
    """Robots that cross and robots that fall, against the distance to the gap."""
    return ReachStudy(gap=summary["settings"]["gap"]).draw(summary, {})["reach.png"]


def success(summary: dict[str, Any]) -> Figure:
    """Robots that cross with one try, by size of the obstacle."""
    (figure,) = TerrainStudy().draw(summary, {}).values()
    return figure


def margins(summary: dict[str, Any]) -> Figure:
    """Margins of a robot's parameters, by ground and mode."""
    return MarginsStudy().draw(summary, {})["margins.png"]


def crossed(summary: dict[str, Any]) -> Figure:
    """Robots that cross, by fault, ground and mode."""
    # The row of mode blind, of any fault, is below those of the others.
    modes = {mode: select(summary["runs"], mode=mode) for mode in ("camera", "memory", "blind")}
    return crossed_table(modes)


def filtered(summary: dict[str, Any]) -> Figure:
    """Delay and switches of the selector's filter, against the weight of a verdict."""
    rates = tuple(summary["settings"]["rates"])
    return FilterStudy(rates=rates).draw(summary, {})["filter.png"]


def driven(summary: dict[str, Any]) -> Figure:
    """Velocities asked for and done."""
    return CommandStudy().draw(summary, {})["commands.png"]


FIGURES = {
    "crossed": ("shipped/severity_5", crossed),
    "driven": ("driving/commands", driven),
    "filter": ("shipped/filter", filtered),
    "go2_memory": ("go2/memory", memory),
    "margins": ("shipped/margins", margins),
    "memory": ("shipped/memory", memory),
    "reach": ("shipped/reach", reach),
    "success": ("shipped/success", success),
}
"""File of the results and function that draws them, by the figure's name."""


def with_exact_intervals(summary: dict[str, Any], count: str, share: str) -> dict[str, Any]:
    """A summary whose shares have Clopper and Pearson's intervals; earlier ones are bootstraps."""
    rows = []
    for row in summary["runs"]:
        successes = np.arange(row["robots"]) < row[count]
        rows.append(row | with_share_interval(share, successes))
    return summary | {"runs": rows}


def origin(summary: Mapping[str, Any]) -> Provenance:
    """The provenance of a summary, or of a file of the form in which faults are published."""
    made = summary["provenance"]
    if "bundle" in made:
        return Provenance(**made)
    policy = summary["policy"]
    return Provenance(
        bundle=policy["name"],
        bundle_hash=policy["sha256"],
        engine=made["engine"],
        seed=summary["protocol"]["seed"],
        command=made["command"],
        date=made["date"],
        renet_version=made["renet"],
        commit=made["commit"],
    )


def main(names: list[str], folder: Path = ROOT / "docs" / "figures") -> None:
    """Draw the figures of these names, or all, into a folder."""
    for name in names or FIGURES:
        file, draw = FIGURES[name]
        summary = json.loads((RESULTS / f"{file}.json").read_text())
        if draw.__name__ in COUNTS:
            summary = with_exact_intervals(summary, *COUNTS[draw.__name__])
        with plt.rc_context(STYLE):
            save_figure(draw(summary), folder / f"{name}.png", origin(summary))


def parse_names(arguments: list[str]) -> list[str]:
    """Parse the names of figures; ends the program with code 2 for an unknown one."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(FIGURES))
    names: list[str] = parser.parse_args(arguments).names
    for name in names:
        if name not in FIGURES:
            parser.error(f"no figure {name!r}: choose among {', '.join(FIGURES)}")
    return names


if __name__ == "__main__":
    main(parse_names(sys.argv[1:]))
