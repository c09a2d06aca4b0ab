"""`renet demo`: break the camera of the shipped policy and watch it keep walking, on one page."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from renet.evaluation.figures import noise_label
from renet.evaluation.lab import Lab
from renet.evaluation.noise import TITLES, NoiseCfg, NoiseResult, run_noise, show_runs
from renet.evaluation.noise_page import facts, headline, noise_section
from renet.evaluation.page import Page
from renet.evaluation.terminal import progress
from renet.evaluation.video import Panel, VideoCfg, make_video
from renet.vocabulary import CONTROL_DT, STEPS_PER_TICK


@dataclass(frozen=True)
class DemoCfg:
    """Settings of the demo."""

    out: Path = Path("renet-demo")
    """Folder for index.html, summary.json, summary.csv, the figures and the video."""
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
    result = run_noise(study, lab)
    show_runs(result.summary)
    film = film_comparison(result, cfg.out / "video.mp4") if cfg.video else None
    return write_page(result, film, cfg.out)


def film_comparison(result: NoiseResult, path: Path, cfg: VideoCfg | None = None) -> Path:
    """Film VP alone beside RENet, the same robot number, in the setting VP does worst in."""
    cfg = cfg or VideoCfg()
    setting, robot = worst_of_vp(result)
    rows = [int(result.indices(mode, setting)[robot]) for mode in ("vp", "renet")]
    film, trace = result.trace.film, result.trace
    assert film is not None
    steps = np.arange(0, result.cfg.steps, round(1 / (cfg.fps * CONTROL_DT)))
    label = noise_label(*setting)
    panels = [
        Panel(
            title=TITLES[mode],
            depth=film.images[steps // STEPS_PER_TICK, row],
            vision=trace.vision[steps, row],
            fallen=trace.fallen[steps, row],
            fault=[label if failing else "" for failing in trace.failing[steps, row]],
            speed=trace.speed[steps, row],
        )
        for mode, row in zip(("vp", "renet"), rows, strict=True)
    ]
    # A robot that fell is put back at its start by the simulator: its picture stops instead.
    stop = [_last_upright(trace.fallen[:, row]) for row in rows]
    poses = np.stack(
        [film.poses[np.minimum(steps, end), row] for row, end in zip(rows, stop, strict=True)], 1
    )
    with progress("video", len(steps)) as advance:
        return make_video(path, result.lab.scene_spec, poses, panels, cfg, advance)


def worst_of_vp(result: NoiseResult) -> tuple[tuple[str, float], int]:
    """The noise setting with most VP falls, then the slowest, and the first robot it fells."""
    fallen, speed = result.trace.fallen, result.trace.speed[-150:]

    def harm(setting: tuple[str, float]) -> tuple[float, float]:
        index = result.indices("vp", setting)
        return fallen[-1, index].sum(), -speed[:, index].mean()

    setting = max(result.cfg.settings, key=harm)
    index = result.indices("vp", setting)
    upright = (~fallen[:, index]).sum(axis=0)
    # Who fell before the noise began says nothing about it.
    upright = np.where(upright < result.cfg.onset, len(fallen) + 1, upright)
    return setting, int(np.lexsort((speed[:, index].mean(axis=0), upright))[0])


def _last_upright(fallen: np.ndarray) -> int:
    """The last control step of [T] at which a robot has not fallen yet."""
    return max(int((~fallen).sum()) - 1, 0)


def write_page(result: NoiseResult, film: Path | None, out: Path) -> Path:
    """Write index.html into `out`, from the study's figures there."""
    summary = result.summary
    page = Page("A robot dog loses its eyes", headline(summary))
    page.facts(facts(summary))
    if film:
        setting, _ = worst_of_vp(result)
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
