"""Result files: a policy, where its numbers come from, and a row for every episode."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from jsonschema import Draft202012Validator

from renet.errors import RenetError, printable
from renet.evaluation.benchmark.episodes import EPISODES, QUICK_EPISODES, SEALED_EPISODES, SEED
from renet.evaluation.benchmark.scores import Row
from renet.evaluation.results import read_results

BENCHMARK = "renet-faults"
VERSION = 3
SETS = {
    "quick": range(QUICK_EPISODES),
    "full": range(EPISODES),
    "sealed": range(EPISODES, EPISODES + SEALED_EPISODES),
}
"""Numbers of the episodes of each set."""


def make_result(
    summary: Mapping[str, Any], method: str, robot: str, episodes: str
) -> dict[str, Any]:
    """The result file of a study's summary.

    Args:
        summary: of `BenchmarkStudy`. method: what the policy is a training of.
        robot: that it drives. episodes: the set that was walked, a key of `SETS`.
    """
    origin = summary["provenance"]
    names = ("commit", "engine", "command", "date")
    return {
        "benchmark": BENCHMARK,
        "version": VERSION,
        "episodes": episodes,
        "policy": {
            "name": origin["bundle"],
            "method": method,
            "robot": robot,
            "sha256": origin["bundle_hash"],
        },
        "provenance": {"renet": origin["renet_version"]} | {name: origin[name] for name in names},
        "scores": summary["scores"],
        "rows": summary["runs"],
    }


@cache
def _validator() -> Draft202012Validator:
    """Checks result files."""
    path = Path(__file__).with_name("result.schema.json")
    return Draft202012Validator(json.loads(path.read_text()))


def read_result(path: Path) -> dict[str, Any]:
    """Read a result file; raises RenetError for any other file, or one without all its rows."""
    content = read_results(path)
    if content.get("benchmark") != BENCHMARK or content.get("version") != VERSION:
        raise RenetError(f"{printable(str(path))} is no result of {BENCHMARK}, version {VERSION}")
    error = next(_validator().iter_errors(content), None)
    if error is not None:
        # The message may quote the whole file; what is wrong with it comes last.
        message = error.message if len(error.message) < 200 else f"… {error.message[-150:]}"
        raise RenetError(printable(f"{path}, {error.json_path}: {message} (docs/benchmark.md)"))
    for entry in content["scores"]:
        numbers = [row["episode"] for row in rows_of_entry(content, entry)]
        if numbers != list(SETS[content["episodes"]]):
            raise RenetError(
                printable(f"{path}: {entry} lacks episodes, or has them in another order")
            )
    return content


def rows_of_entry(result: Mapping[str, Any], entry: str) -> Sequence[Row]:
    """The rows of one entry of a result file."""
    return [row for row in result["rows"] if row["entry"] == entry]


def demand_version_seed(seed: int) -> None:
    """Raise RenetError for a draw that is not the version's."""
    if seed != SEED:
        raise RenetError(f"episodes of seed {seed} are not those of version {VERSION}")
