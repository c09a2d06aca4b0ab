"""`renet evaluate report`: whatever studies have been run, on one self-contained page."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from renet.errors import RenetError
from renet.evaluation.faults import fault_class
from renet.evaluation.noise_page import noise_section
from renet.evaluation.page import Cell, Page
from renet.evaluation.results import output_folder, read_json


@dataclass(frozen=True)
class ReportCfg:
    """Where the results are and the page goes."""

    results: Path = Path("results")
    """Folder with the studies' folders: noise, terrain, faults, filter."""
    out: Path = Path("results/index.html")
    """The page."""


def make_report(cfg: ReportCfg) -> Path:
    """Assemble the page from every study found and return its path.

    Raises:
        RenetError: no study has been run, or its results are damaged.
    """
    found = [
        (name, section, cfg.results / name)
        for name, section in SECTIONS.items()
        if (cfg.results / name / "summary.json").exists()
    ]
    if not found:
        raise RenetError(
            f"no results in {cfg.results}: run `renet evaluate noise` or another study first"
        )
    page = Page(
        "RENet, measured",
        "What a robot dog's policy does on hard ground and when its depth camera fails, in"
        " simulation, from the exported ONNX models. Falls are judged by the robot's true pose;"
        " what went wrong is shown, too.",
    )
    for name, section, folder in found:
        summary = read_json(folder / "summary.json")
        try:
            section(page, summary, folder)
            page.provenance(summary["provenance"])
        except (KeyError, FileNotFoundError) as error:
            raise RenetError(
                f"the results of {name} in {folder} are incomplete ({error}): run the study again"
            ) from error
    output_folder(cfg.out.parent)
    return page.write(cfg.out)


def _terrain(page: Page, summary: dict[str, Any], folder: Path) -> None:
    """The paper's table."""
    settings = summary["settings"]
    page.heading("Parkour: how far up the curriculum")
    page.text(
        f"{summary['robots']} robots on every level of every tile, {settings['speed']} m/s"
        " commanded in a random direction. A robot passes a level when it leaves the tile within"
        f" {settings['seconds']:g} s; its level is the number passed in a row, out of 10."
    )
    levels, intervals = summary["levels"], summary["levels_ci95"]
    page.table(
        ["terrain", "mean highest level", "95 % interval"],
        [
            (name, f"{level:.2f}", "{:.2f} to {:.2f}".format(*intervals[name]))
            for name, level in levels.items()
        ],
    )
    page.facts(
        [
            (f"{summary['collisions']:.3f}", "colliding bodies per robot and step"),
            (f"{summary['lin_vel_reward']:.3f}", "linear velocity reward, of 1"),
        ]
    )
    page.picture(folder / "terrain.png", "Share of robots that pass each level.")


def _faults(page: Page, summary: dict[str, Any], folder: Path) -> None:
    """The fault benchmark, with its misses."""
    settings, healthy = summary["settings"], summary["healthy"]
    page.heading("Every way a depth camera fails")
    page.text(
        f"Terrain {settings['terrain']}, {settings['speed']} m/s commanded, each run"
        f" {summary['run_seconds']:g} s, faults from {settings['onset'] * 0.02:g} s on. While their"
        f" cameras were healthy the robots left vision {healthy['false_switches']} times in"
        f" {healthy['robot_hours']:.2f} robot hours."
    )
    page.picture(folder / "survival.png", "Robots on their feet at the end, in percent.")
    page.table(
        ["fault", "level", "mode", "on their feet", "95 % interval", "speed (m/s)", "delay (s)"],
        [_fault_row(run) for run in summary["runs"] if run["mode"] == "renet"],
        text=3,
    )
    page.heading("Where RENet does worse than never looking")
    page.text("RENet's survival is more than 2 points below that of the OP estimator alone.")
    page.table(
        ["fault", "severity", "RENet", "OP alone"],
        [
            (f["fault"], f["severity"], f"{100 * f['renet']:.0f} %", f"{100 * f['op']:.0f} %")
            for f in summary["harmful"]
        ]
        or [("none", "", "", "")],
    )
    page.heading("Faults that make VP fall and go unnoticed")
    page.table(
        ["fault", "severity", "robots that did not notice", "falls of VP alone"],
        [(m["fault"], m["severity"], m["undetected"], m["vp_falls"]) for m in summary["missed"]]
        or [("none", "", "", "")],
    )
    page.picture(
        folder / "gallery.png",
        "What each fault looks like, severities 1 to 5 from left to right. Faults of time (frozen,"
        " dropped, latency, unplugged) leave the image as it is.",
    )


def _fault_row(run: dict[str, Any]) -> tuple[Any, ...]:
    delay = run["detection_delay_s"]
    level = run["level"] if run["level"] != "inf" else float("inf")
    interval = (100 * run["survival_ci95_low"], 100 * run["survival_ci95_high"])
    return (
        run["fault"].replace("_", " "),
        fault_class(run["fault"]).describe(level),
        run["mode"],
        Cell(f"{100 * run['survival']:.0f} %", "bad" if run["falls"] else "good"),
        "{:.0f} to {:.0f} %".format(*interval),
        f"{run['mean_forward_velocity']:.2f}",
        "not noticed" if delay is None else f"{delay:.3f}",
    )


def _filter(page: Page, summary: dict[str, Any], folder: Path) -> None:
    """The filter figure."""
    page.heading("The selector's filter")
    page.text(
        "A filter with weight γ that runs at a given rate delays the switch; a heavy one rides out"
        " a flickering camera (0.1 s of noise in every 0.4 s), a light one follows it."
    )
    page.picture(
        folder / "filter.png",
        "Delay against the formula (dotted: the paper's 0.04 s), and switches per minute.",
    )


SECTIONS: dict[str, Callable[[Page, dict[str, Any], Path], None]] = {
    "noise": noise_section,
    "terrain": _terrain,
    "faults": _faults,
    "filter": _filter,
}


def main(cfg: ReportCfg) -> None:
    """`renet evaluate report`."""
    print(f"Open {make_report(cfg).resolve()} in a browser.")
