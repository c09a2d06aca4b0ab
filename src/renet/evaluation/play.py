"""`renet play`: a bundle or a checkpoint on any tile, live in the browser or filmed."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

import tyro

from renet.deploy.bundle import MANIFEST
from renet.deploy.bundle.manifest import Manifest
from renet.deploy.policy import Policy
from renet.errors import RenetError
from renet.evaluation.lab import Lab
from renet.evaluation.maps import MapLog
from renet.evaluation.results import output_folder
from renet.evaluation.rollout import Row, check_modes, run_rollout
from renet.evaluation.terminal import progress
from renet.evaluation.video import VideoCfg, make_video, panels_of
from renet.evaluation.world import FLAT
from renet.faults import Injection
from renet.interface import CONTROL_DT
from renet.tasks import RenetEnvCfg, Robot, env_cfg
from renet.tasks.config import flat_env_cfg, tile_env_cfg
from renet.tasks.go1 import GO1
from renet.tasks.terrains import single_tile_terrain
from renet.training.bundle import ExportCfg, export


@dataclass(frozen=True)
class PlayCfg:
    """Watch one robot live in the browser, or film it, once for each policy mode, side by side."""

    bundle: tyro.conf.Positional[Path | None] = None
    """Bundle folder, or a checkpoint or run folder; the bundle that ships with renet by default."""
    log: Path | None = None
    """Flight log of `renet deploy` to film instead of driving a robot."""
    viewer: Literal["auto", "viser", "none"] = "auto"
    """viser: live, in the browser; none: a film; auto: live where there is a terminal."""
    host: str = "127.0.0.1"
    """Address the viewer listens on; 0.0.0.0 lets other machines watch."""
    port: int = 8080
    """Port the viewer listens on."""
    out: Path | None = None
    """The film; results/play.mp4 by default."""
    terrain: str = FLAT
    """flat, or a kind of tile: rough, obstacles, stairs_up, stairs_down, gap, platform."""
    level: int = 1
    """Level of the tile, 1 to 10."""
    fault: str | None = None
    """A camera fault of the benchmark, e.g. gaussian, frozen, glare."""
    severity: int = 3
    """Its severity, 1 to 5."""
    onset: float = 3.0
    """Seconds at which a film's fault begins; the viewer begins with it."""
    modes: tuple[str, ...] = ("vp", "renet")
    """Policy modes a film compares: vp, renet, op, oracle-switch."""
    seconds: float = 8.0
    """Length of the film, simulated."""
    speed: float = 0.6
    """Commanded forward speed, m/s."""
    seed: int = 1
    """Of the robot's body, start and noise."""
    selector: str = "monitors"
    """monitors: all of them, slow to trust again; paper: the reconstruction loss against beta."""
    engine: str = "auto"
    """Physics engine: auto, native or warp."""


def run_play(cfg: PlayCfg) -> Path | None:
    """Show a policy until Ctrl-C, or make its film and return it.

    Raises:
        RenetError: unknown terrain, fault or mode, a bundle that cannot be used, or a taken port.
    """
    if cfg.log is not None:
        from renet.evaluation.film_log import film_log

        return film_log(cfg.log, cfg.out)
    if cfg.viewer == "viser" or (cfg.viewer == "auto" and sys.stdout.isatty()):
        _watch(cfg)
        return None
    return _film(cfg)


@contextmanager
def opened(path: Path | None) -> Iterator[Path | None]:
    """A bundle's folder; a checkpoint is exported to one that lasts as long as the block.

    Raises:
        RenetError: a folder that holds neither.
    """
    if path is None or (path / MANIFEST).exists() or not path.exists():
        yield path
        return
    with TemporaryDirectory() as folder:
        yield export(ExportCfg(checkpoint=path, out=Path(folder) / path.name))


def robot_of(manifest: Manifest) -> Robot:
    """The robot a bundle was trained on; raises RenetError if its task is not registered here."""
    task = manifest.provenance.task
    try:
        return env_cfg(task).robot if task else GO1
    except RenetError as error:
        raise RenetError(
            f"the bundle's task {task} is unknown here: start from the file that describes its"
            f" robot, {manifest.robot.name} (docs/robots.md)"
        ) from error


def ground(terrain: str, level: int, robot: Robot) -> RenetEnvCfg:
    """The task on flat ground or on one tile; raises RenetError for an unknown tile or level."""
    if terrain == FLAT:
        return flat_env_cfg(play=True, robot=robot)
    return tile_env_cfg(single_tile_terrain(terrain, level), play=True, robot=robot)


def _watch(cfg: PlayCfg) -> None:
    """Serve the viewer."""
    from renet.evaluation.live import Session
    from renet.evaluation.live_view import watch

    with opened(cfg.bundle) as folder:
        lab = Lab(folder, cfg.engine, cfg.selector)
        task = ground(cfg.terrain, cfg.level, robot_of(lab.bundle.manifest))
        session = Session(lab, task, cfg.speed, cfg.seed)
        if cfg.fault is not None:
            session.inject(cfg.fault, cfg.severity)
        watch(session, cfg.host, cfg.port)


def _film(cfg: PlayCfg) -> Path:
    """Drive the robots and film them."""
    if cfg.seconds < 1.0:
        raise RenetError(f"a film needs at least one second, got {cfg.seconds}")
    check_modes(cfg.modes)
    schedule = ()
    if cfg.fault is not None:
        schedule = (Injection.of(cfg.fault, cfg.severity, round(cfg.onset / CONTROL_DT)),)
    rows = [Row(mode, schedule) for mode in cfg.modes]
    out = cfg.out or Path("results/play.mp4")
    count, steps = len(rows), round(cfg.seconds / CONTROL_DT)
    with opened(cfg.bundle) as folder:
        lab = Lab(folder, cfg.engine, cfg.selector)
        task = ground(cfg.terrain, cfg.level, robot_of(lab.bundle.manifest))
        output_folder(out.parent)
        world, policy = lab.world(task, [0] * count, cfg.speed, cfg.seed), Policy(lab.bundle, count)
    log = MapLog(policy, world)
    with progress(f"{cfg.terrain}, {count} robots", steps) as advance:
        trace = run_rollout(
            world,
            policy,
            lab.switch(count),
            rows,
            steps,
            cfg.seed,
            range(count),
            advance,
            on_sight=log.note,
        )
    look = VideoCfg()
    titles = dict(enumerate(cfg.modes))
    panels, poses = panels_of(trace, titles, cfg.fault or "", look.fps, log.maps)
    assert lab.scene_spec is not None
    with progress("video", len(poses)) as advance:
        return make_video(out, lab.scene_spec, poses, panels, look, advance)
