"""What pages say about the noise study."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from renet.evaluation.figures import MODE_NAMES, noise_label
from renet.evaluation.page import Cell, Page

WALKS = (0.75, 1.42)
"""Shares of the commanded speed between which a robot counts as walking."""


def noise_section(page: Page, summary: dict[str, Any], folder: Path) -> None:
    """Table, comparison and timeline of a noise study whose figures lie in `folder`."""
    settings = summary["settings"]
    page.heading("Noise in the camera")
    page.text(
        f"{summary['runs'][0]['robots']} robots in each row, flat ground,"
        f" {settings['speed']} m/s commanded, noise from timestep {settings['onset']}."
        " Speed is the mean over the last 3 s, with its"
        " 95 % bootstrap interval; a fallen robot counts with zero. GA is Gaussian noise"
        " with that standard deviation, SP salt and pepper on that share of the pixels. Delay is"
        " the median time from the noise's begin to the switch."
    )
    page.table(
        ["policy", "noise", "falls", "speed (m/s)", "95 % interval", "switch delay (ms)"],
        [_table_row(run, settings["speed"]) for run in summary["baseline"] + summary["runs"]],
        text=2,
    )
    page.picture(
        folder / "noise.png",
        "Mean forward velocity against timestep (0.02 s), as in the paper.",
    )
    page.heading("One robot's camera fails and recovers")
    page.picture(
        folder / "timeline.png",
        "Reconstruction loss and threshold on the left axis, vision"
        " probability on the right. Green: VP in charge. Red: OP in charge.",
    )


def headline(summary: dict[str, Any]) -> str:
    """One sentence that says what was measured, good or bad."""
    falls = {
        mode: sum(r["falls"] for r in summary["runs"] if r["mode"] == mode)
        for mode in ("vp", "renet")
    }
    trials = [r["robots"] for r in summary["runs"] if r["mode"] == "renet"]
    return (
        f"{len(trials)} kinds of camera noise, {sum(trials)} robots: {falls['vp']} fell with the"
        f" vision estimator alone, {falls['renet']} with RENet."
    )


def facts(summary: dict[str, Any]) -> list[tuple[str, str]]:
    """The page's large numbers; none where RENet was not run."""
    renet = [run for run in summary["runs"] if run["mode"] == "renet"]
    if not renet:
        return []
    speeds = [run["mean_forward_velocity"] for run in renet]
    delays = [r["detection_delay_s"] for r in renet if r["detection_delay_s"] is not None]
    robots = sum(run["robots"] for run in renet)
    return [
        (
            f"{robots - sum(run['falls'] for run in renet)} of {robots}",
            "RENet robots on their feet",
        ),
        (f"{min(speeds):.2f}–{max(speeds):.2f} m/s", "RENet's mean speed under noise"),
        (f"{1000 * max(delays):.0f} ms" if delays else "none", "slowest median switch to OP"),
        (str(summary["healthy"]["false_switches"]), "false switches while the camera was healthy"),
    ]


def _table_row(run: dict[str, Any], command: float) -> list[Any]:
    """One setting of one mode; `command` is the commanded speed, m/s."""
    falls, speed, delay = run["falls"], run["mean_forward_velocity"], run["detection_delay_s"]
    return [
        MODE_NAMES[run["mode"]],
        noise_label(run["noise"], run["level"]),
        Cell(f"{falls} of {run['robots']}", "bad" if falls else "good"),
        Cell(f"{speed:.2f}", "good" if WALKS[0] <= speed / command <= WALKS[1] else "bad"),
        f"{run['velocity_ci95_low']:.2f} to {run['velocity_ci95_high']:.2f}",
        "–" if delay is None else f"{1000 * delay:.0f}",
    ]
