"""`renet bundle card`: a model card in the Hugging Face Hub's format, from a bundle's own files."""

import json
import re
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import tyro

from renet.bundle import MANIFEST, Bundle
from renet.bundle.models import MODELS
from renet.errors import RenetError
from renet.files import read_object, write_atomically

CARD = "README.md"
"""Name that the Hub shows as a repository's card."""
MAX_SUMMARY = 64_000_000
"""Bytes."""


@dataclass(frozen=True)
class CardCfg:
    """Write a bundle's model card: README.md in the Hugging Face Hub's format."""

    out: Path
    """Folder for README.md."""
    bundle: tyro.conf.Positional[Path | None] = None
    """Bundle folder; the one that ships with renet by default."""
    results: Path | None = None
    """Folder of studies of this bundle, each with the summary.json of `renet evaluate`."""
    license: str = "apache-2.0"
    """License of the weights, as the Hub names it."""


def write_card(cfg: CardCfg) -> Path:
    """Write the card; returns the folder of README.md.

    Raises:
        RenetError: a damaged bundle, results that are missing, damaged or of another bundle, or a
            folder that cannot be written to.
    """
    if not re.fullmatch(r"[a-z0-9.+-]+", cfg.license):
        raise RenetError(f"--license {cfg.license!r}: give the Hub's identifier, e.g. apache-2.0")
    bundle = Bundle.load(cfg.bundle)
    text = card(bundle, _read_summaries(cfg.results, bundle), cfg.license)
    write_atomically(cfg.out / CARD, text.encode(), "card")
    return cfg.out


def card(bundle: Bundle, summaries: Sequence[dict[str, Any]], license: str) -> str:
    """Markdown with YAML front matter; every number is read from the bundle or from the summaries.

    Args:
        bundle: verified. summaries: contents of summary.json of studies of this bundle.
        license: the Hub's identifier.
    """
    front = {
        "license": license,
        "library_name": "renet",
        "pipeline_tag": "robotics",
        "tags": ["robotics", "quadruped", "locomotion", "depth-camera", "onnx", "mujoco"],
    }
    parts = [
        "\n".join(["---", *(f"{k}: {json.dumps(v)}" for k, v in front.items()), "---"]),
        f"# {escape(bundle.path.resolve().name)}",
        _what_it_is(bundle),
        "## What it can do",
        *(_study(summary) for summary in summaries),
        *([] if summaries else ["No study's results were given, so nothing is claimed here."]),
        "## Known limits",
        "\n".join(f"- {limit}" for limit in _limits(bundle, summaries)),
        "## Provenance",
        _table(("", ""), _provenance(bundle)),
        "## Files",
        _table(("file", "bytes", "SHA-256"), _files(bundle)),
        "## How to run it",
        "With renet installed and these files in `FOLDER`:",
        "```bash\nrenet bundle inspect FOLDER\nrenet deploy FOLDER --robot mujoco\n```",
    ]
    return "\n\n".join(parts) + "\n"


def escape(value: Any) -> str:
    """One line of text in which no character means anything to Markdown or HTML."""
    text = " ".join(str(value).split())
    text = "".join(c if c.isprintable() else " " for c in text)
    text = text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    return re.sub(r"([\\`*_\[\]|#!~])", r"\\\1", text)


def _what_it_is(bundle: Bundle) -> str:
    manifest = bundle.manifest
    camera = manifest.camera
    return (
        f"A locomotion policy for the {escape(manifest.robot.name)}"
        f" ({len(manifest.robot.joints)} joints) with a depth camera of {camera.height} ×"
        f" {camera.width} pixels, {camera.range:g} m range, {camera.rate_hz:g} Hz. It has two"
        " estimators of the robot's state, one with and one without the camera; a selector"
        f" decides at {manifest.selector.rate_hz:g} Hz which of them the actor follows. Three ONNX"
        " models; NumPy and ONNX Runtime run them."
    )


def _study(summary: dict[str, Any]) -> str:
    """A study's heading, tables and the command that made them."""
    made, runs = summary["provenance"], summary["runs"]
    parts = [f"### {escape(summary['study'])}"]
    if "levels" in summary:
        intervals = summary.get("levels_ci95", {})
        rows = [(k, v, _interval(intervals.get(k))) for k, v in summary["levels"].items()]
        parts.append(_table(("tile", "mean highest level", "95 % interval"), rows))
    parts.append(_by_mode(runs))
    if summary.get("claims"):
        rows = [
            (c["claim"], "met" if c["met"] else "not met", c.get("measured", ""))
            for c in summary["claims"]
        ]
        parts.append(_table(("claim", "", "measured"), rows))
    parts.append(
        f"Seed {escape(made['seed'])}, {escape(made['engine'])} engine, renet"
        f" {escape(made['renet_version'])}, {escape(made['date'])}: {escape(made['command'])}"
    )
    return "\n\n".join(part for part in parts if part)


def _by_mode(runs: Sequence[dict[str, Any]]) -> str:
    """Sums over all settings of each mode."""
    rows = []
    for mode in dict.fromkeys(str(run.get("mode", "")) for run in runs):
        mode_runs = [run for run in runs if str(run.get("mode", "")) == mode]
        sums = [sum(run.get(key) or 0 for run in mode_runs) for key in ("robots", "falls")]
        rows.append((mode, len(mode_runs), *sums))
    return _table(("mode", "settings", "robots", "falls"), rows)


def _limits(bundle: Bundle, summaries: Sequence[dict[str, Any]]) -> Iterable[str]:
    """What the files show that the policy cannot do or was not tested for."""
    if not bundle.manifest.selector.healthy_hours:
        yield "The selector's thresholds were never calibrated on healthy runs."
    for summary in summaries:
        study = escape(summary["study"])
        for claim in summary.get("claims", ()):
            if not claim["met"]:
                yield f"{study}: not met: {escape(claim['claim'])} ({escape(claim['measured'])})"
        modes = dict.fromkeys(run["mode"] for run in summary["runs"] if run.get("falls"))
        for mode in modes:
            mode_runs = [r for r in summary["runs"] if r.get("mode") == mode and "falls" in r]
            fell = [r for r in mode_runs if r["falls"]]
            yield (
                f"{study}: with {escape(mode)}, robots fell {sum(r['falls'] for r in fell)} times,"
                f" in {len(fell)} of {len(mode_runs)} settings"
            )
        for miss in summary.get("missed", ()):
            yield (
                f"{study}: {escape(miss['fault'])} of severity {escape(miss['severity'])} went"
                f" unnoticed by {escape(miss['undetected'])} robots"
            )
    yield "It was measured in simulation; these files hold no result of a real robot."


def _provenance(bundle: Bundle) -> list[tuple[str, Any]]:
    selector = bundle.manifest.selector
    return [
        ("bundle", bundle.sha256),
        *((key, value) for key, value in asdict(bundle.manifest.provenance).items() if value != ""),
        ("threshold beta", selector.beta),
        ("calibration", selector.calibration or "none"),
        ("healthy robot hours of the calibration", selector.healthy_hours),
    ]


def _files(bundle: Bundle) -> list[tuple[str, int, str]]:
    files = [(f"{name}.onnx", bundle.manifest.sha256[f"{name}.onnx"]) for name in MODELS]
    return [
        (name, (bundle.path / name).stat().st_size, digest)
        for name, digest in [*files, (MANIFEST, "")]
    ]


def _table(header: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(_cell(v) for v in line)} |" for line in lines)


def _cell(value: Any) -> str:
    if value is None:
        return "–"
    return f"{value:.6g}" if isinstance(value, float) else escape(value)


def _interval(ends: Any) -> str:
    is_interval = isinstance(ends, Sequence) and len(ends) == 2 and None not in ends
    return f"{ends[0]:.3g} to {ends[1]:.3g}" if is_interval else "–"


def _read_summaries(folder: Path | None, bundle: Bundle) -> list[dict[str, Any]]:
    """Contents of every summary.json in a folder and in those inside it, by study."""
    if folder is None:
        return []
    paths = sorted([*folder.glob("summary.json"), *folder.glob("*/summary.json")])
    if not paths:
        raise RenetError(f"no summary.json in {folder}: give a folder that `renet evaluate` wrote")
    return [_read_summary(path, bundle) for path in paths]


def _read_summary(path: Path, bundle: Bundle) -> dict[str, Any]:
    """A summary that can be shown: of this bundle, and of the shape that studies write."""
    summary = read_object(path, "summary", MAX_SUMMARY)
    try:
        made = summary["provenance"]
        if not all(isinstance(run, dict) for run in summary["runs"]):
            raise TypeError("runs must be objects")
        # Whatever else it lacks shows here, before anything is written.
        card(bundle, [summary], "")
        of_another = made["bundle_hash"] != bundle.sha256
    except KeyError as error:
        raise RenetError(f"{path} is no study's summary: it lacks {error}") from error
    except (ValueError, TypeError, AttributeError) as error:
        raise RenetError(f"{path} is no study's summary: {error}") from error
    if of_another:
        raise RenetError(f"{path} is of another bundle: run the study with this one")
    return summary
