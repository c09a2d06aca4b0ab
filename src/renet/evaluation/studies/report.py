"""`renet evaluate report`: whatever studies have been run, on one self-contained page.

With `--run` it runs them all first: one command computes every number again.
"""

import sys
from dataclasses import dataclass
from pathlib import Path

from renet.errors import RenetError
from renet.evaluation.report.page import reading, refuse_link, render, study_sections, write_page
from renet.evaluation.report.summary import overview_section, worse_section
from renet.evaluation.results import read_results
from renet.evaluation.studies.camera_use import CameraUseStudy
from renet.evaluation.studies.faults import FaultStudy
from renet.evaluation.studies.margins import MarginsStudy
from renet.evaluation.studies.memory import MemoryStudy
from renet.evaluation.studies.noise import NoiseStudy
from renet.evaluation.studies.standing import StandingStudy
from renet.evaluation.studies.terrain import SuccessStudy, TerrainStudy
from renet.evaluation.study import Study
from renet.interface import Engine

STUDIES: dict[str, type[Study]] = {
    "noise": NoiseStudy,
    "faults": FaultStudy,
    "memory": MemoryStudy,
    "camera_use": CameraUseStudy,
    "success": SuccessStudy,
    "terrain": TerrainStudy,
    "standing": StandingStudy,
    "margins": MarginsStudy,
}
"""Studies in the order of the page."""


@dataclass(frozen=True)
class ReportCfg:
    """Where the results are and the page goes."""

    results: Path = Path("results")
    """Folder with a folder for each study: noise, faults, memory, success, terrain, …"""
    out: Path | None = None
    """The page; index.html in `results` by default."""
    run: bool = False
    """Run every study first; what an interrupted run has finished is kept."""
    quick: bool = False
    """With `run`: the quick form of every study; the full ones take 1.6 hours on one core."""
    bundle: Path | None = None
    """With `run`: bundle folder or name, as for every study."""
    seed: int = 1
    """With `run`: of every study."""
    jobs: int = 1
    """With `run`: processes that make every study's parts."""
    engine: Engine = "auto"
    """With `run`: physics engine, on the CPU; auto: native."""


def make_report(cfg: ReportCfg) -> Path:
    """Assemble the page of all studies that have been run; raises RenetError if it cannot."""
    if cfg.run:
        run_studies(cfg)
    files = ((name, cfg.results / name / "summary.json") for name in STUDIES)
    paths = {name: path for name, path in files if path.exists()}
    for path in paths.values():
        refuse_link(path, cfg.results)
    summaries = {name: read_results(path) for name, path in paths.items()}
    if not summaries:
        raise RenetError(
            f"no results in {cfg.results}: run `renet evaluate report --run --quick`,"
            " or one study, first"
        )
    # Each study first, so that a damaged one is reported by its name.
    studies = [
        section
        for name, summary in summaries.items()
        for section in study_sections(name, summary, cfg.results / name)
    ]
    with reading(", ".join(summaries)):
        top = [overview_section(summaries), render("how_to_read"), worse_section(summaries)]
    out = cfg.out or cfg.results / "index.html"
    lead = (
        "What a robot dog's policy does on hard ground and when its depth camera fails, in"
        " simulation, from the exported ONNX models. Falls are judged by the robot's true pose;"
        " what went wrong is shown first."
    )
    return write_page(out, "RENet, measured", lead, [*top, *studies])


def run_studies(cfg: ReportCfg) -> None:
    """Run every study into its folder in `results`; raises as `Study.run`."""
    from renet.evaluation.evaluator import Evaluator

    Evaluator(cfg.bundle, cfg.engine)
    for number, (name, study) in enumerate(STUDIES.items(), start=1):
        print(f"{number}/{len(STUDIES)} {name}", file=sys.stderr)
        settings = (cfg.results / name, cfg.bundle, cfg.quick, cfg.seed, cfg.engine)
        study(*settings, jobs=cfg.jobs).main()
