"""`renet bundle card`: a model card for the Hugging Face Hub, from the files of a bundle.

Its front matter follows the Hub's specification, `modelcard.md` of github.com/huggingface/hub-docs.
"""

import json
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import tyro

from renet.bundle import Bundle
from renet.errors import RenetError
from renet.files import MAX_JSON, read_bytes, read_object, write_atomically

MAX_SUMMARY = 64_000_000
"""Largest size of a study's summary, bytes."""
_START = b"---\n"
"""First line of every card, which begins with a front matter."""
_NOTHING = "No study's results were given, so nothing is claimed here."


@dataclass(frozen=True)
class CardCfg:
    """Write a bundle's model card: README.md in the Hugging Face Hub's format."""

    out: Path
    """Folder for README.md, which may be the bundle's own."""
    bundle: tyro.conf.Positional[Path | None] = None
    """Bundle folder, or the name of one that ships: go1-parkour (the default), go1-driven,
    go2-parkour, go2-driven; or hf://OWNER/NAME on the Hugging Face Hub."""
    results: Path | None = None
    """Folder of studies of this bundle, each with the summary.json of `renet evaluate`."""
    license: str = "apache-2.0"
    """License of the weights, as the Hub names it."""


def write_card(cfg: CardCfg) -> Path:
    """Write the card; returns the folder of README.md.

    Raises:
        RenetError: a damaged bundle, results that are missing, damaged or of another bundle, or a
            folder that cannot be written to or whose README.md is no card.
    """
    if not re.fullmatch(r"[a-z0-9.+-]+", cfg.license):
        raise RenetError(f"--license {cfg.license!r}: give the Hub's identifier, e.g. apache-2.0")
    bundle = Bundle.load(cfg.bundle)
    summaries = [] if cfg.results is None else [*_read_summaries(cfg.results, bundle)]
    path = cfg.out / "README.md"
    # A README.md without a front matter was written by hand.
    if os.path.lexists(path) and not read_bytes(path, MAX_JSON, "card").startswith(_START):
        raise RenetError(f"{path} is no model card: move it, or choose another folder")
    write_atomically(path, card(bundle, summaries, cfg.license).encode(), "card")
    return cfg.out


def card(bundle: Bundle, summaries: Sequence[dict[str, Any]], license: str) -> str:
    """Return a card: Markdown with YAML front matter.

    Every number is read from the bundle or from its studies.

    Args:
        bundle: The bundle that is described.
        summaries: Contents of the `summary.json` of each of its studies.
        license: The Hub's identifier of a license.
    """
    name = bundle.path.resolve().name
    robot = bundle.manifest.robot
    camera = bundle.manifest.camera
    selector = bundle.manifest.selector
    drives = escape_markdown(robot.name)
    results = [_result(summary) for summary in summaries]
    return f"""\
---
license: {license}
library_name: renet
pipeline_tag: robotics
tags: [robotics, quadruped, locomotion, depth-camera, onnx, mujoco]
model-index:
- name: {_yaml(name)}
  results: {_yaml(results)}
---

# {escape_markdown(name)}

A locomotion policy for the {drives} ({len(robot.joints)} joints) with a depth camera of
{camera.height} × {camera.width} pixels, {camera.range:g} m range, {camera.rate_hz:g} Hz. It has two
estimators of the robot's state, one with and one without the camera. A selector decides at
{selector.rate_hz:g} Hz which of them the actor follows. Three ONNX models; NumPy and ONNX Runtime
run them.

## Results

{_results_table(results)}

## Limits and how the results were made

{_limits(bundle, summaries)}

## Provenance

{_provenance_table(bundle)}

## How to run it

With renet installed and these files in `FOLDER`:

```bash
renet bundle inspect FOLDER
renet deploy FOLDER --robot mujoco
```
"""


def _results_table(results: Sequence[dict[str, Any]]) -> str:
    """Table of all metrics of the studies, or a sentence where there is none."""
    rows = []
    for result in results:
        for metric in result["metrics"]:
            rows.append((result["dataset"]["type"], metric["name"], metric["value"]))
    return _table(("study", "measured", ""), rows) if rows else _NOTHING


def _limits(bundle: Bundle, summaries: Sequence[dict[str, Any]]) -> str:
    """Bullets that limit the claims: of the bundle first, then of each study."""
    remarks = ["It was measured in simulation; these files hold no result of a real robot."]
    if not bundle.manifest.selector.healthy_hours:
        remarks.append("The selector's thresholds were never calibrated on healthy runs.")
    for summary in summaries:
        for remark in _remarks(summary):
            remarks.append(escape_markdown(f"{summary['study']}: {remark}"))
    return "\n".join(f"- {remark}" for remark in remarks)


def _provenance_table(bundle: Bundle) -> str:
    """Table of the weights' origin, the selector's calibration and the models' digests."""
    manifest = bundle.manifest
    selector = manifest.selector
    origin: dict[str, Any] = {"bundle": bundle.sha256}
    for key, value in asdict(manifest.provenance).items():
        if value != "":
            origin[key] = value
    origin["threshold beta"] = selector.beta
    origin["calibration"] = selector.calibration or "none"
    origin["healthy robot hours of the calibration"] = selector.healthy_hours
    for file, digest in manifest.sha256.items():
        origin[f"SHA-256 of {file}"] = digest
    return _table(("", ""), origin.items())


def escape_markdown(value: Any) -> str:
    """Put a value on one line in which no character means anything to Markdown or HTML."""
    text = " ".join(str(value).split())
    text = "".join(c if c.isprintable() else " " for c in text)
    text = text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    return re.sub(r"([\\`*_\[\]|#!~])", r"\\\1", text)


def _read_summaries(folder: Path, bundle: Bundle) -> Iterator[dict[str, Any]]:
    """Read the studies in a folder and its subfolders; raises RenetError for a file of none."""
    paths = sorted([*folder.glob("summary.json"), *folder.glob("*/summary.json")])
    if not paths:
        raise RenetError(f"no summary.json in {folder}: give a folder that `renet evaluate` wrote")
    for path in paths:
        summary = read_object(path, "summary", MAX_SUMMARY)
        try:
            of_bundle = summary["provenance"]["bundle_hash"] == bundle.sha256
            # Whatever the summary lacks fails here, before anything is written.
            card(bundle, [summary], "")
        except (KeyError, ValueError, TypeError, AttributeError) as error:
            why = f"it lacks {error}" if isinstance(error, KeyError) else error
            raise RenetError(f"{path} is no study's summary: {why}") from error
        if not of_bundle:
            raise RenetError(f"{path} is of another bundle: run the study with this one")
        yield summary


def _result(summary: dict[str, Any]) -> dict[str, Any]:
    """A study's entry in the Hub's model-index.

    The Hub wants a data set of each result: the study and its command stand for it.
    """
    metrics = [*_level_metrics(summary), *_fall_metrics(summary)]
    return {
        "task": {"type": "robotics", "name": "quadruped locomotion in simulation"},
        "dataset": {"type": summary["study"], "name": summary["provenance"]["command"]},
        "metrics": metrics,
    }


def _level_metrics(summary: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Mean highest level that robots reached on each kind of tile."""
    intervals = summary.get("levels_ci95", {})
    for tile, level in summary.get("levels", {}).items():
        low, high = intervals.get(tile, (None, None))
        interval = "" if None in (low, high) else f" (95 % interval {low:.3g} to {high:.3g})"
        name = f"mean highest level, {tile}{interval}"
        yield {"type": "level", "name": name, "value": float(level)}


def _fall_metrics(summary: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Falls of all robots that were driven in each mode."""
    runs = [run for run in summary["runs"] if "falls" in run]
    # Each mode once, in the order of the runs.
    for mode in dict.fromkeys(run["mode"] for run in runs):
        of_mode = [run for run in runs if run["mode"] == mode]
        falls = [run["falls"] for run in of_mode]
        robots = sum(run.get("robots", 1) for run in of_mode)
        settings = f"{sum(map(bool, falls))} of {len(falls)} settings"
        name = f"falls of {robots} robots with {mode}, in {settings}"
        yield {"type": "falls", "name": name, "value": sum(falls)}


def _remarks(summary: dict[str, Any]) -> Iterator[str]:
    """Sentences on a study: its command and date, its claims, and the faults it did not notice."""
    origin = summary["provenance"]
    yield "{command}, seed {seed}, {engine} engine, renet {renet_version}, {date}".format(**origin)
    for claim in summary.get("claims", ()):
        yield f"{'' if claim['met'] else 'not '}met: {claim['claim']} ({claim['measured']})"
    for miss in summary.get("missed", ()):
        yield "{undetected} robots did not notice {fault} of severity {severity}".format(**miss)


def _yaml(value: Any) -> str:
    """Write a value as JSON on one line, which is YAML, too."""
    text = json.dumps(value, ensure_ascii=False)
    return "".join(c if c.isprintable() else " " for c in text)


def _table(header: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Markdown table, with numbers to six digits."""
    lines = [_row(header), _row(["---"] * len(header))]
    for row in rows:
        cells = []
        for value in row:
            cells.append(f"{value:.6g}" if isinstance(value, float) else escape_markdown(value))
        lines.append(_row(cells))
    return "\n".join(lines)


def _row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"
