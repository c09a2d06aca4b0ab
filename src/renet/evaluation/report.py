"""`renet evaluate report`: whatever studies have been run, on one self-contained page.

With `--run` it runs them all first: one command that makes every number anew.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from renet.errors import RenetError
from renet.evaluation.course import CourseCfg, run_course
from renet.evaluation.fault_page import faults_section
from renet.evaluation.fault_study import FaultsCfg, run_faults
from renet.evaluation.filter_study import FilterCfg, run_filter
from renet.evaluation.glance import glance_section, worse_section
from renet.evaluation.lab import Lab
from renet.evaluation.noise import NoiseCfg, run_noise
from renet.evaluation.noise_page import noise_section
from renet.evaluation.page import Page
from renet.evaluation.pictures import PicturesCfg, run_pictures
from renet.evaluation.results import output_folder, read_json
from renet.evaluation.standing import StandingCfg, run_standing
from renet.evaluation.study_pages import (
    course_section,
    filter_section,
    pictures_section,
    standing_section,
    success_section,
    terrain_section,
)
from renet.evaluation.success import SuccessCfg, run_success
from renet.evaluation.terminal import console
from renet.evaluation.terrain import TerrainCfg, run_terrain

SECTIONS: dict[str, Callable[[Page, dict[str, Any], Path], None]] = {
    "noise": noise_section,
    "faults": faults_section,
    "success": success_section,
    "terrain": terrain_section,
    "standing": standing_section,
    "course": course_section,
    "filter": filter_section,
    "pictures": pictures_section,
}
"""Studies in the order of the page."""


@dataclass(frozen=True)
class ReportCfg:
    """Where the results are and the page goes."""

    results: Path = Path("results")
    """Folder with the studies' folders: noise, faults, success, terrain, standing, course, filter,
    pictures."""
    out: Path | None = None
    """The page; index.html in `results` by default."""
    run: bool = False
    """Run every study first; what an interrupted run has finished is kept."""
    quick: bool = False
    """With `run`: the quick form of every study, about half an hour on two cores."""
    bundle: Path | None = None
    """With `run`: bundle folder; the one that ships with renet by default."""
    seed: int = 1
    """With `run`: of every study."""
    engine: str = "auto"
    """With `run`: physics engine, auto, native or warp."""


def make_report(cfg: ReportCfg) -> Path:
    """Assemble the page from every study found and return its path.

    Raises:
        RenetError: no study has been run, or its results are damaged.
    """
    if cfg.run:
        run_studies(cfg)
    found = {
        name: read_json(cfg.results / name / "summary.json")
        for name in SECTIONS
        if (cfg.results / name / "summary.json").exists()
    }
    if not found:
        raise RenetError(
            f"no results in {cfg.results}: run `renet evaluate report --run --quick`,"
            " or one study, first"
        )
    page = Page(
        "RENet, measured",
        "What a robot dog's policy does on hard ground and when its depth camera fails, in"
        " simulation, from the exported ONNX models. Falls are judged by the robot's true pose;"
        " what went wrong is shown first.",
    )
    _write(found, page, cfg.results)
    out = cfg.out or cfg.results / "index.html"
    output_folder(out.parent)
    return page.write(out)


def _write(found: Mapping[str, dict[str, Any]], page: Page, results: Path) -> None:
    """All sections of the page; damaged results are reported with the study's name."""
    parts: list[tuple[str, Callable[[], None]]] = [
        ("the studies", lambda: glance_section(page, found)),
        ("the studies", lambda: explain(page)),
        ("the studies", lambda: worse_section(page, found)),
    ]
    for name, summary in found.items():
        parts.append((name, lambda n=name, s=summary: SECTIONS[n](page, s, results / n)))
        parts.append((name, lambda s=summary: page.provenance(s["provenance"])))
    for name, part in parts:
        try:
            part()
        except (KeyError, FileNotFoundError) as error:
            raise RenetError(
                f"the results of {name} in {results} are incomplete ({error}): run it again"
            ) from error


def explain(page: Page) -> None:
    """What a stranger needs to know to read on."""
    page.heading("How to read this")
    page.text(
        "One policy has two estimators. VP sees depth images and its own body, OP its own body"
        " only. An autoencoder and other monitors watch the images; when they look unhealthy the"
        " selector hands over from VP to OP, and hands back when they recover. “RENet” is"
        " the policy with its selector; “VP alone” always looks, “OP alone” never does. Every"
        " study ends with where its numbers come from: bundle, seed, engine, date and command."
    )


def run_studies(cfg: ReportCfg) -> None:
    """Run every study into its folder in `results`.

    Raises:
        RenetError: a bundle that cannot be used, or a folder that cannot be written to.
    """
    Lab(cfg.bundle, cfg.engine)
    common = {"bundle": cfg.bundle, "seed": cfg.seed, "engine": cfg.engine}
    out = {name: {"out": cfg.results / name, **common} for name in SECTIONS}
    studies: dict[str, Callable[[], Any]] = {
        "noise": lambda: run_noise(NoiseCfg(**out["noise"], quick=cfg.quick)),
        "filter": lambda: run_filter(FilterCfg(**out["filter"], quick=cfg.quick)),
        "terrain": lambda: run_terrain(TerrainCfg(**out["terrain"], quick=cfg.quick)),
        "success": lambda: run_success(SuccessCfg(**out["success"], quick=cfg.quick)),
        "standing": lambda: run_standing(StandingCfg(**out["standing"], quick=cfg.quick)),
        "course": lambda: run_course(CourseCfg(**out["course"], quick=cfg.quick)),
        "faults": lambda: run_faults(FaultsCfg(**out["faults"], quick=cfg.quick)),
        "pictures": lambda: run_pictures(PicturesCfg(**out["pictures"])),
    }
    for number, (name, study) in enumerate(studies.items(), start=1):
        console.print(f"[bold]{number}/{len(studies)} {name}")
        study()


def main(cfg: ReportCfg) -> None:
    """`renet evaluate report`."""
    print(f"Open {make_report(cfg).resolve()} in a browser.")
