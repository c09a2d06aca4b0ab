"""`renet play`: film a bundle on any tile, with any camera fault, without a display."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from renet.errors import RenetError
from renet.evaluation.faults import Injection
from renet.evaluation.lab import Lab
from renet.evaluation.results import output_folder
from renet.evaluation.rollout import Film, Row, Trace, run_rollout
from renet.evaluation.terminal import progress
from renet.evaluation.video import Panel, VideoCfg, make_video
from renet.tasks.config import tile_env_cfg
from renet.tasks.terrains import single_tile_terrain
from renet.vocabulary import CONTROL_DT, STEPS_PER_TICK

FLAT = "flat"


@dataclass(frozen=True)
class PlayCfg:
    """Film one robot, once for each policy mode, side by side."""

    bundle: tyro.conf.Positional[Path | None] = None
    """Bundle folder; the one that ships with renet by default."""
    out: Path = Path("results/play.mp4")
    """The video."""
    terrain: str = FLAT
    """flat, or a kind of tile: rough, obstacles, stairs_up, stairs_down, gap, platform."""
    level: int = 1
    """Level of the tile, 1 to 10."""
    fault: str | None = None
    """A camera fault of the benchmark, e.g. gaussian, frozen, glare."""
    severity: int = 3
    """Its severity, 1 to 5."""
    onset: float = 3.0
    """Seconds at which the fault begins."""
    modes: tuple[str, ...] = ("vp", "renet")
    """Policy modes to compare: vp, renet, op, oracle-switch."""
    seconds: float = 8.0
    """Length, simulated."""
    speed: float = 0.6
    """Commanded forward speed, m/s."""
    seed: int = 1
    """Of the robot's body, start and noise."""
    engine: str = "auto"
    """Physics engine: auto, native or warp."""


def run_play(cfg: PlayCfg) -> Path:
    """Make the video and return it.

    Raises:
        RenetError: unknown terrain, fault or mode, or a bundle that cannot be used.
    """
    if cfg.seconds < 1.0:
        raise RenetError(f"a film needs at least one second, got {cfg.seconds}")
    schedule = ()
    if cfg.fault is not None:
        schedule = (Injection.of(cfg.fault, cfg.severity, round(cfg.onset / CONTROL_DT)),)
    rows = [Row(mode, schedule) for mode in cfg.modes]
    lab = Lab(cfg.bundle, cfg.engine)
    tile = cfg.terrain != FLAT
    task = (
        tile_env_cfg(single_tile_terrain(cfg.terrain, cfg.level), play=True)
        if tile
        else "Renet-Go1-Flat"
    )
    output_folder(cfg.out.parent)
    count, steps = len(rows), round(cfg.seconds / CONTROL_DT)
    world = lab.world(task, [0] * count, cfg.speed, cfg.seed)
    with progress(f"{cfg.terrain}, {count} robots", steps) as advance:
        trace = run_rollout(
            world,
            lab.controller(count),
            lab.switch(count),
            rows,
            steps,
            cfg.seed,
            range(count),
            advance,
        )
    assert trace.film is not None
    return _draw(cfg, lab, trace, trace.film)


def _draw(cfg: PlayCfg, lab: Lab, trace: Trace, film: Film) -> Path:
    """Stamp and write the frames."""
    look = VideoCfg()
    frames = np.arange(0, len(trace.fallen), round(1 / (look.fps * CONTROL_DT)))
    panels = [
        Panel(
            title=mode,
            depth=film.images[frames // STEPS_PER_TICK, row],
            vision=trace.vision[frames, row],
            fallen=trace.fallen[frames, row],
            fault=[(cfg.fault or "") if failing else "" for failing in trace.failing[frames, row]],
            speed=trace.speed[frames, row],
        )
        for row, mode in enumerate(cfg.modes)
    ]
    assert lab.scene_spec is not None
    # A robot that fell is put back at its start by the simulator: its picture stops instead.
    upright = np.maximum((~trace.fallen).sum(axis=0) - 1, 0)
    poses = np.stack([film.poses[np.minimum(frames, end), r] for r, end in enumerate(upright)], 1)
    with progress("video", len(frames)) as advance:
        return make_video(cfg.out, lab.scene_spec, poses, panels, look, advance)
