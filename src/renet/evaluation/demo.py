"""`renet demo`: break the camera of the shipped policy and watch it keep walking, on one page."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from renet.evaluation.report.page import provenance_section, render, write_page
from renet.evaluation.report.summary import noise_facts, noise_headline
from renet.evaluation.studies.benchmark import Setting
from renet.evaluation.studies.fault_findings import setting_of
from renet.evaluation.studies.noise import NoiseStudy
from renet.evaluation.trace import Trace
from renet.interface import CONTROL_DT, Engine
from renet.terminal import show

if TYPE_CHECKING:
    from renet.evaluation.evaluator import Evaluator


@dataclass(frozen=True)
class DemoCfg:
    """Settings of the demo."""

    out: Path = Path("renet-demo")
    """Folder for index.html, summary.json, summary.csv, figures, video and parts/."""
    bundle: Path | None = None
    """Bundle folder; the one that ships with renet by default."""
    seed: int = 1
    """Seed of the robots' starts and of the noise."""
    engine: Engine = "auto"
    """Physics engine; auto: native on a CPU, warp on a GPU."""


def run_demo(cfg: DemoCfg, evaluator: Evaluator | None = None) -> Path:
    """Run the paper's noise study and put its results on one page; raises as `Study.run`."""
    study = NoiseStudy(out=cfg.out, bundle=cfg.bundle, seed=cfg.seed, engine=cfg.engine)
    evaluator = evaluator or study.make_evaluator()
    summary = study.run(evaluator)
    for table in study.tables(summary):
        show(*table)
    setting = worst_of_vp(summary)
    video = film_comparison(study, evaluator, setting, cfg.out / "video.mp4")
    sections = [
        render("demo", facts=noise_facts(summary), film=video, noise=label(setting)),
        render("demo_method"),
        render("noise", summary=summary, settings=summary["settings"], folder=cfg.out),
        render("demo_provenance"),
        provenance_section(summary),
    ]
    page, title = cfg.out / "index.html", "A robot dog loses its eyes"
    return write_page(page, title, noise_headline(summary), sections)


def film_comparison(
    study: NoiseStudy,
    evaluator: Evaluator,
    setting: Setting,
    path: Path,
    fps: int = 25,
) -> Path:
    """Film VP alone beside RENet: one setting walks again, as it did in the study."""
    from renet.evaluation.report.video import film

    modes = {"vp": "VP alone: always on camera", "renet": "RENet"}
    trials = study.trials([setting])
    env = study.make_env(evaluator, tuple(trial.robot for trial in trials))
    trace = study.walk(evaluator, env, "one setting, filmed", trials, film=range(len(trials)))
    robot = first_to_fall(study, trace)
    titles = {study.modes.index(m) * study.robots_each + robot: t for m, t in modes.items()}
    return film(path, env.scene_spec, trace, titles, label(setting), fps)


def worst_of_vp(summary: dict[str, Any]) -> Setting:
    """The noise with most VP falls, then the slowest."""
    alone = [run for run in summary["runs"] if run["mode"] == "vp"]
    worst = max(alone, key=lambda run: (run["falls"], -run["mean_forward_velocity"]))
    return setting_of(worst)


def label(setting: Setting) -> str:
    """A noise in words, such as "salt and pepper 30 %"."""
    return f"{setting.fault.replace('_', ' ')} {100 * setting.level:.0f} %"


def first_to_fall(study: NoiseStudy, trace: Trace) -> int:
    """The first robot that falls under VP once the noise has begun, then the slowest."""
    start = study.modes.index("vp") * study.robots_each
    index = slice(start, start + study.robots_each)
    upright = (~trace.fallen[:, index]).sum(axis=0)
    # Who fell before the noise began says nothing about it.
    upright = np.where(upright * CONTROL_DT < study.onsets[0], study.steps + 1, upright)
    return int(np.lexsort((trace.speed[-150:, index].mean(axis=0), upright))[0])
