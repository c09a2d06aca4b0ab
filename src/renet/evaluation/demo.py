"""`renet demo`: break the camera of the shipped policy and watch it keep walking, on one page."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from renet.evaluation.figures import MODE_NAMES, noise_label
from renet.evaluation.lab import Lab
from renet.evaluation.noise import (
    NoiseCfg,
    Setting,
    build_world,
    run_noise,
    show_runs,
    walk,
)
from renet.evaluation.noise_page import facts, headline, noise_section
from renet.evaluation.page import Page
from renet.evaluation.terminal import progress
from renet.evaluation.trace import Trace
from renet.evaluation.video import VideoCfg, make_video, panels_of


@dataclass(frozen=True)
class DemoCfg:
    """Settings of the demo."""

    out: Path = Path("renet-demo")
    """Folder for index.html, summary.json, summary.csv, figures, video and parts/."""
    bundle: Path | None = None
    """Bundle folder; the one that ships with renet by default."""
    seed: int = 1
    """Of the robots' starts and of the noise."""
    engine: str = "auto"
    """Physics engine: auto, native or warp."""
    video: bool = True
    """Make the video; it takes about half a minute."""


def run_demo(cfg: DemoCfg, lab: Lab | None = None) -> Path:
    """Run the paper's noise study on the CPU and put its results on one page.

    Args:
        cfg: settings.
        lab: where the robots are; made from `cfg.bundle` by default.

    Returns:
        The page, `cfg.out/index.html`.

    Raises:
        RenetError: a bundle that cannot be used, or a folder that cannot be written to.
    """
    study = NoiseCfg(out=cfg.out, bundle=cfg.bundle, seed=cfg.seed, engine=cfg.engine)
    lab = lab or Lab(study.bundle, study.engine, study.selector)
    summary = run_noise(study, lab)
    show_runs(summary)
    setting = worst_of_vp(summary)
    film = film_comparison(study, lab, setting, cfg.out / "video.mp4") if cfg.video else None
    return write_page(summary, film, setting, cfg.out)


def film_comparison(
    study: NoiseCfg, lab: Lab, setting: Setting, path: Path, cfg: VideoCfg | None = None
) -> Path:
    """Film VP alone beside RENet: one setting walks again, as it did in the study."""
    cfg, modes = cfg or VideoCfg(), ("vp", "renet")
    everybody = range(len(study.modes) * study.each)
    trace = walk(study, lab, build_world(study, lab), setting, "one setting, filmed", everybody)
    robot = first_to_fall(study, trace)
    titles = {study.rows_of(mode).start + robot: MODE_NAMES[mode] for mode in modes}
    panels, poses = panels_of(trace, titles, noise_label(*setting), cfg.fps)
    with progress("video", len(poses)) as advance:
        return make_video(path, lab.scene_spec, poses, panels, cfg, advance)


def worst_of_vp(summary: dict[str, Any]) -> Setting:
    """The noise setting with most VP falls, then the slowest."""
    alone = [run for run in summary["runs"] if run["mode"] == "vp"]
    worst = max(alone, key=lambda run: (run["falls"], -run["mean_forward_velocity"]))
    return worst["noise"], worst["level"]


def first_to_fall(study: NoiseCfg, trace: Trace) -> int:
    """The first robot that falls under VP once the noise has begun, then the slowest."""
    index = study.rows_of("vp")
    upright = (~trace.fallen[:, index]).sum(axis=0)
    # Who fell before the noise began says nothing about it.
    upright = np.where(upright < study.onset, study.steps + 1, upright)
    return int(np.lexsort((trace.speed[-150:, index].mean(axis=0), upright))[0])


def write_page(summary: dict[str, Any], film: Path | None, setting: Setting, out: Path) -> Path:
    """Write index.html into `out`, from the study's figures there; the film is of `setting`."""
    page = Page("A robot dog loses its eyes", headline(summary))
    page.facts(facts(summary))
    if film:
        page.video(
            film,
            f"Same noise, {noise_label(*setting)}, from 3 s on. Left: the estimator that trusts"
            " vision, alone. Right: RENet. Inset: the depth image the robot gets; its frame is"
            " green while vision is trusted and red while it is not. A picture that stops is a"
            " robot that fell.",
        )
    page.heading("What RENet is")
    page.text(
        "RENet (Redundant Estimator Networks, IEEE RA-L 2025) trains one policy with two"
        " estimators: VP sees depth images and its own body, OP its own body only. An autoencoder"
        " trained on the same depth images measures how strange the newest ones are (the anomaly"
        " score). When it stays above the threshold β, the vision probability P_t falls below one"
        " half and the selector hands over to OP; it hands back when vision recovers."
    )
    noise_section(page, summary, out)
    page.heading("Where these numbers come from")
    page.text(
        "Every number and picture on this page was computed on this machine by the command"
        " below, from the exported ONNX models, in simulation."
    )
    page.provenance(summary["provenance"])
    return page.write(out / "index.html")


def main(cfg: DemoCfg) -> None:
    """`renet demo`."""
    page = run_demo(cfg)
    print(f"Open {page.resolve()} in a browser.")
