"""`renet bundle card`: a model card for the Hugging Face Hub, from a bundle's own files.

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
"""Bytes."""
START = b"---\n"
"""The first line of a front matter, with which every card begins."""
NOTHING = "No study's results were given, so nothing is claimed here."


@dataclass(frozen=True)
class CardCfg:
    """Write a bundle's model card: README.md in the Hugging Face Hub's format."""

    out: Path
    """Folder for README.md, which may be the bundle's own."""
    bundle: tyro.conf.Positional[Path | None] = None
    """Bundle folder, or the name of one that ships: go1-parkour (the default), go2-parkour; or
    hf://OWNER/NAME on the Hugging Face Hub."""
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
    if os.path.lexists(path) and not read_bytes(path, MAX_JSON, "card").startswith(START):
        raise RenetError(f"{path} is no model card: move it, or choose another folder")
    write_atomically(path, card(bundle, summaries, cfg.license).encode(), "card")
    return cfg.out


def card(bundle: Bundle, summaries: Sequence[dict[str, Any]], license: str) -> str:
    """Markdown with YAML front matter; every number is read from the bundle or from its studies.

    `summaries` are the contents of their summary.json; `license` is the Hub's identifier.
    """
    manifest, name = bundle.manifest, bundle.path.resolve().name
    robot, camera, selector = manifest.robot, manifest.camera, manifest.selector
    results = [_result(summary) for summary in summaries]
    rows = [(r["dataset"]["type"], m["name"], m["value"]) for r in results for m in r["metrics"]]
    remarks = ["It was measured in simulation; these files hold no result of a real robot."]
    if not selector.healthy_hours:
        remarks.append("The selector's thresholds were never calibrated on healthy runs.")
    for summary in summaries:
        remarks += [escape(f"{summary['study']}: {remark}") for remark in _remarks(summary)]
    bullets = "\n".join(f"- {remark}" for remark in remarks)
    origin = {
        "bundle": bundle.sha256,
        **{k: v for k, v in asdict(manifest.provenance).items() if v != ""},
        "threshold beta": selector.beta,
        "calibration": selector.calibration or "none",
        "healthy robot hours of the calibration": selector.healthy_hours,
        **{f"SHA-256 of {file}": digest for file, digest in manifest.sha256.items()},
    }.items()
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

# {escape(name)}

A locomotion policy for the {escape(robot.name)} ({len(robot.joints)} joints) with a depth camera of
{camera.height} × {camera.width} pixels, {camera.range:g} m range, {camera.rate_hz:g} Hz. It has two
estimators of the robot's state, one with and one without the camera. A selector decides at
{selector.rate_hz:g} Hz which of them the actor follows. Three ONNX models; NumPy and ONNX Runtime
run them.

## Results

{_table(("study", "measured", ""), rows) if rows else NOTHING}

## Limits and how the results were made

{bullets}

## Provenance

{_table(("", ""), origin)}

## How to run it

With renet installed and these files in `FOLDER`:

```bash
renet bundle inspect FOLDER
renet deploy FOLDER --robot mujoco
```
"""


def escape(value: Any) -> str:
    """One line of text in which no character means anything to Markdown or HTML."""
    text = " ".join(str(value).split())
    text = "".join(c if c.isprintable() else " " for c in text)
    text = text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    return re.sub(r"([\\`*_\[\]|#!~])", r"\\\1", text)


def _read_summaries(folder: Path, bundle: Bundle) -> Iterator[dict[str, Any]]:
    """The studies in a folder and in those inside it; raises RenetError for what is none."""
    paths = sorted([*folder.glob("summary.json"), *folder.glob("*/summary.json")])
    if not paths:
        raise RenetError(f"no summary.json in {folder}: give a folder that `renet evaluate` wrote")
    for path in paths:
        summary = read_object(path, "summary", MAX_SUMMARY)
        try:
            of_bundle = summary["provenance"]["bundle_hash"] == bundle.sha256
            card(bundle, [summary], "")  # Whatever it lacks shows before anything is written.
        except (KeyError, ValueError, TypeError, AttributeError) as error:
            why = f"it lacks {error}" if isinstance(error, KeyError) else error
            raise RenetError(f"{path} is no study's summary: {why}") from error
        if not of_bundle:
            raise RenetError(f"{path} is of another bundle: run the study with this one")
        yield summary


def _result(summary: dict[str, Any]) -> dict[str, Any]:
    """A study's entry in the Hub's model-index; study and command stand for the data set."""
    metrics, intervals = [], summary.get("levels_ci95", {})
    for tile, level in summary.get("levels", {}).items():
        low, high = intervals.get(tile, (None, None))
        interval = "" if None in (low, high) else f" (95 % interval {low:.3g} to {high:.3g})"
        name = f"mean highest level, {tile}{interval}"
        metrics.append({"type": "level", "name": name, "value": float(level)})
    runs = [run for run in summary["runs"] if "falls" in run]
    for mode in dict.fromkeys(run["mode"] for run in runs):
        falls = [run["falls"] for run in runs if run["mode"] == mode]
        robots = sum(run.get("robots", 1) for run in runs if run["mode"] == mode)
        settings = f"{sum(map(bool, falls))} of {len(falls)} settings"
        name = f"falls of {robots} robots with {mode}, in {settings}"
        metrics.append({"type": "falls", "name": name, "value": sum(falls)})
    return {
        "task": {"type": "robotics", "name": "quadruped locomotion in simulation"},
        "dataset": {"type": summary["study"], "name": summary["provenance"]["command"]},
        "metrics": metrics,
    }


def _remarks(summary: dict[str, Any]) -> Iterator[str]:
    """How a study's numbers were made, whether its claims were met, and what went unnoticed."""
    origin = summary["provenance"]
    yield "{command}, seed {seed}, {engine} engine, renet {renet_version}, {date}".format(**origin)
    for claim in summary.get("claims", ()):
        yield f"{'' if claim['met'] else 'not '}met: {claim['claim']} ({claim['measured']})"
    for miss in summary.get("missed", ()):
        yield "{undetected} robots did not notice {fault} of severity {severity}".format(**miss)


def _yaml(value: Any) -> str:
    """JSON on one line, which is YAML, too."""
    return "".join(c if c.isprintable() else " " for c in json.dumps(value, ensure_ascii=False))


def _table(header: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    lines = [(f"{v:.6g}" if isinstance(v, float) else escape(v) for v in row) for row in rows]
    lines = [header, ["---"] * len(header), *lines]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
