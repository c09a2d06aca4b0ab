"""Result files: a policy, the provenance of its numbers, and a row for every episode."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from renet.errors import RenetError, printable
from renet.evaluation.benchmark.episodes import EPISODES, QUICK_EPISODES, SEALED_EPISODES
from renet.evaluation.benchmark.scores import EpisodeRow
from renet.evaluation.results import column, read_results, select

if TYPE_CHECKING:
    from jsonschema import Draft202012Validator

BENCHMARK = "renet-faults"
"""Name of the benchmark."""
BENCHMARK_VERSION = 3
"""Version of its episodes and scores."""
SETS = {
    "quick": range(QUICK_EPISODES),
    "full": range(EPISODES),
    "sealed": range(EPISODES, EPISODES + SEALED_EPISODES),
}
"""Numbers of the episodes of each set."""


def make_result(summary: Mapping[str, Any], method: str, episodes: str) -> dict[str, Any]:
    """Build the content of a result file.

    Args:
        summary: Summary of a `BenchmarkStudy`.
        method: Name of the method that the policy is a training of.
        episodes: The set of episodes that was walked, a key of `SETS`. Other words are only good
            for tables, because `read_result` refuses them.
    """
    origin = summary["provenance"]
    provenance = {"renet": origin["renet_version"]}
    for name in ("commit", "engine", "command", "date"):
        provenance[name] = origin[name]
    return {
        "benchmark": BENCHMARK,
        "version": BENCHMARK_VERSION,
        "episodes": episodes,
        "policy": {
            "name": origin["bundle"],
            "method": method,
            "robot": summary["robot"],
            "sha256": origin["bundle_hash"],
        },
        "provenance": provenance,
        "scores": summary["scores"],
        "rows": summary["runs"],
    }


@cache
def _validator() -> Draft202012Validator:
    """Make the validator of the schema of result files."""
    # Only whoever reads results needs it: neither a study nor its --help.
    from jsonschema import Draft202012Validator

    path = Path(__file__).with_name("result.schema.json")
    return Draft202012Validator(json.loads(path.read_text()))


def read_result(path: Path) -> dict[str, Any]:
    """Read a result file; raises RenetError if it is no result, or lacks rows."""
    content = read_results(path)
    if content.get("benchmark") != BENCHMARK or content.get("version") != BENCHMARK_VERSION:
        raise RenetError(
            f"{printable(str(path))} is no result of {BENCHMARK}, version {BENCHMARK_VERSION}"
        )
    error = next(_validator().iter_errors(content), None)
    if error is not None:
        # The message may quote the whole file; the reason is at its end.
        message = error.message if len(error.message) < 200 else f"… {error.message[-150:]}"
        raise RenetError(printable(f"{path}, {error.json_path}: {message} (docs/benchmark.md)"))
    # Scores compare entries by the same episodes, so none may be missing.
    for entry in content["scores"]:
        numbers = column(rows_of_entry(content, entry), "episode")
        if numbers != list(SETS[content["episodes"]]):
            raise RenetError(
                printable(f"{path}: {entry} lacks episodes, or has them in another order")
            )
    if any(row["crossed"] > row["obstacles"] for row in content["rows"]):
        raise RenetError(printable(f"{path}: a row has more obstacles crossed than there are"))
    return content


def rows_of_entry(result: Mapping[str, Any], entry: str) -> Sequence[EpisodeRow]:
    """Return the rows of one entry of a result file."""
    return select(result["rows"], entry=entry)
