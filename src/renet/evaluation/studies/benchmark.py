"""The fault benchmark: grounds and onsets of version 1, and the result files of both versions.

docs/benchmark.md and docs/crossing.md are the specifications.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from jsonschema import Draft202012Validator

from renet.errors import RenetError
from renet.evaluation.results import read_results
from renet.faults import Injection, fault_class
from renet.interface import CONTROL_DT, Terrain

BENCHMARK = "renet-faults"
GROUNDS: dict[Terrain, int] = {
    "flat": 1,
    "stairs_up": 6,
    "stairs_down": 10,
    "obstacles": 10,
    "platform": 6,
    "gap": 3,
}
"""Grounds and their levels, 1 to 10."""
ONSETS = {0.5: "on_the_way", 1.5: "before_the_edge"}
"""Names of the seconds at which faults begin."""
LISTED = (
    "gaussian",
    "salt_and_pepper",
    "blackout",
    "saturated",
    "frozen",
    "dropped",
    "latency",
    "occlusion",
    "blobs",
    "grass",
    "glare",
    "glare_filled",
    "near_field",
    "glass",
    "foam",
    "motion_blur",
    "mount_knocked",
    "wrong_scale",
    "unplugged",
    "edge_shadow",
    "disparity_steps",
    "textureless",
    "tall_grass",
    "glare_dropped",
    "blobs_latency",
    "shadow_steps",
    "intermittent_blackout",
    "intermittent_frozen",
    "intermittent_glare",
)
"""Faults of version 1, from which version 2 draws: a seed draws by their order. The catalogue has
grown since."""
PROTOCOL = ("seed", "speed", "lasts", "seconds", "quick")
"""Settings of the study that a result file tells; seconds, m/s."""
PAGES = {1: "benchmark", 2: "crossing"}
"""Page of each version in docs/, and the name of its result files' JSON Schema (2020-12)."""


class Setting(NamedTuple):
    """What happens to a group of robots."""

    ground: str
    onset: float
    """Seconds."""
    fault: str
    severity: int

    @property
    def step(self) -> int:
        """Control step at which the fault begins."""
        return round(self.onset / CONTROL_DT)

    @property
    def level(self) -> float:
        """Strength of the fault, in its own unit."""
        return fault_class(self.fault).level_of(self.severity)

    def injection(self, seconds: float) -> Injection:
        """The fault, over after some seconds at the latest."""
        return Injection.of(self.fault, self.severity, self.step, seconds)


def header(summary: Mapping[str, Any], version: int) -> dict[str, Any]:
    """What every result file begins with: which policy, and where its numbers come from."""
    origin = summary["provenance"]
    names = ("commit", "engine", "command", "date")
    return {
        "benchmark": BENCHMARK,
        "version": version,
        "policy": {
            "name": origin["bundle"],
            "url": None,
            "sha256": origin["bundle_hash"],
            "modes": summary["settings"]["modes"],
        },
        "provenance": {"renet": origin["renet_version"], **{name: origin[name] for name in names}},
    }


def result(summary: Mapping[str, Any]) -> dict[str, Any]:
    """The result file of a fault study's summary; its onsets must be the benchmark's."""
    settings = summary["settings"]
    return header(summary, 1) | {
        "protocol": {
            "robots": summary["robots"],
            **{name: settings[name] for name in PROTOCOL},
        },
        "settings": [
            {
                **{name: run[name] for name in ("ground", "fault", "severity", "mode", "measures")},
                "level": run["ground_level"],
                "onset": ONSETS[run["onset"]],
            }
            for run in summary["runs"]
        ],
        "by_robot": summary["by_robot"],
    }


def schema(version: int) -> dict[str, Any]:
    """The JSON Schema of a version's result files."""
    return json.loads(Path(__file__).with_name(f"{PAGES[version]}.schema.json").read_text())


def read_result(path: Path) -> dict[str, Any]:
    """A result file, valid under its version's schema; raises RenetError for another file."""
    content = read_results(path)
    version = content.get("version", 0)
    if content.get("benchmark") != BENCHMARK or version not in PAGES:
        raise RenetError(
            f"{path} is no result of {BENCHMARK}, version {' or '.join(map(str, PAGES))}"
        )
    error = next(Draft202012Validator(schema(version)).iter_errors(content), None)
    if error is not None:
        # The message may quote the whole file; what is wrong with it comes last.
        message = error.message if len(error.message) < 200 else f"… {error.message[-150:]}"
        raise RenetError(f"{path}, {error.json_path}: {message} (see docs/{PAGES[version]}.md)")
    return content
