"""The fault benchmark, version 1: its grounds and onsets, and its result files.

docs/benchmark.md is the specification.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from renet.errors import RenetError
from renet.evaluation.results import read_results
from renet.evaluation.studies.fault_metrics import MEASURES

BENCHMARK, VERSION = "renet-faults", 1
GROUNDS = {
    "flat": 1,
    "stairs_up": 3,
    "stairs_down": 3,
    "obstacles": 3,
    "platform": 3,
    "gap": 3,
}
"""Grounds and their levels, 1 to 10."""
ONSETS = {0.5: "on_the_way", 1.5: "before_the_edge"}
"""Names of the seconds at which faults begin."""
KEYS = ("ground", "level", "fault", "severity", "onset", "mode")
"""Of an entry of `settings` beside its measures."""


def result(summary: Mapping[str, Any], commit: str | None = None) -> dict[str, Any]:
    """The result file of a fault study's summary.

    Args:
        summary: of a study whose onsets are the benchmark's.
        commit: of the code that ran it.

    Raises:
        RenetError: other onsets.
    """
    settings, origin = summary["settings"], summary["provenance"]
    unknown = [onset for onset in settings["onsets"] if onset not in ONSETS]
    if unknown:
        raise RenetError(
            f"onset {unknown[0]} s is none of the benchmark's {', '.join(ONSETS.values())}"
        )
    return {
        "benchmark": BENCHMARK,
        "version": VERSION,
        "policy": {
            "name": origin["bundle"],
            "url": None,
            "sha256": origin["bundle_hash"],
            "modes": settings["modes"],
        },
        "provenance": {
            "renet": origin["renet_version"],
            "commit": commit,
            **{name: origin[name] for name in ("engine", "command", "date")},
        },
        "protocol": {
            "robots": summary["robots"],
            **{name: settings[name] for name in ("seed", "speed", "quick")},
        },
        "settings": [
            {
                **{name: run[name] for name in ("ground", "fault", "severity", "mode", "measures")},
                "level": run["ground_level"],
                "onset": ONSETS[run["onset"]],
            }
            for run in summary["runs"]
        ],
    }


def read_result(path: Path) -> dict[str, Any]:
    """A result file of this version.

    Raises:
        RenetError: anything else.
    """
    found = read_results(path)
    if (found.get("benchmark"), found.get("version")) != (BENCHMARK, VERSION):
        raise RenetError(f"{path} is no result of {BENCHMARK}, version {VERSION}")
    try:
        for entry in found["settings"]:
            _ = [entry[name] for name in KEYS]
            _ = [entry["measures"][name]["change"]["value"] for name in MEASURES]
        _ = found["policy"]["name"], found["policy"]["modes"], found["protocol"]["quick"]
    except (KeyError, TypeError) as error:
        raise RenetError(f"{path} lacks {error}: see docs/benchmark.schema.json") from error
    return found
