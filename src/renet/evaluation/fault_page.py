"""What the report says about the fault benchmark, its misses included."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from renet.evaluation.page import Cell, Page
from renet.faults import fault_class


def faults_section(page: Page, summary: dict[str, Any], folder: Path) -> None:
    """The fault benchmark."""
    settings, healthy = summary["settings"], summary["healthy"]
    page.heading("Every way a depth camera fails")
    page.text(
        f"Terrain {settings['terrain']}, {settings['speed']} m/s commanded, each run"
        f" {summary['run_seconds']:g} s, faults from {settings['onset'] * 0.02:g} s on. In the runs"
        f" without faults the robots left vision {healthy['false_switches']} times in"
        f" {healthy['robot_hours']:.2f} robot hours."
    )
    page.table(
        ["promise", "measured", "kept"],
        [
            (c["claim"], c["measured"], Cell(*(("yes", "good") if c["met"] else ("no", "bad"))))
            for c in summary["claims"]
        ],
        text=2,
    )
    page.picture(
        folder / "survival.png", "Robots on their feet at the end, in percent.", photo=True
    )
    page.picture(
        folder / "detection.png",
        "Robots that noticed the fault, in percent of those that trusted vision until then: RENet's"
        " monitors, and the paper's rule alone.",
        photo=True,
    )
    page.picture(folder / "roc.png", "Detection against false alarms, fault by fault.")
    rows = [_fault_row(run) for run in summary["runs"] if run["mode"] == "renet"]
    page.table(
        [
            "fault",
            "level",
            "on their feet",
            "95 % interval",
            "fell by it",
            "speed (m/s)",
            "delay (s)",
        ],
        rows,
        text=2,
        folded=f"All {len(rows)} settings under RENet; “fell by it”: robots that fall only with the"
        " fault, less those that fall only without it",
    )
    page.picture(
        folder / "gallery.png",
        "What each fault looks like, severities 1 to 5 from left to right. Faults of time (frozen,"
        " dropped, latency, unplugged) leave the image as it is.",
        photo=True,
    )


def _fault_row(run: dict[str, Any]) -> tuple[Any, ...]:
    delay = run["detection_delay_s"]
    level = run["level"] if run["level"] != "inf" else float("inf")
    interval = (100 * run["survival_ci95_low"], 100 * run["survival_ci95_high"])
    return (
        run["fault"].replace("_", " "),
        fault_class(run["fault"]).describe(level),
        Cell(f"{100 * run['survival']:.0f} %", "bad" if run["falls"] else "good"),
        "{:.0f} to {:.0f} %".format(*interval),
        f"{run['falls_by_fault'] - run['falls_spared']:d}".replace("-", "−"),
        f"{run['mean_forward_velocity']:.2f}",
        "not noticed" if delay is None else f"{delay:.3f}",
    )
