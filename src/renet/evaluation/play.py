"""`renet play`: watch and film a bundle or a checkpoint whose camera fails, on any ground."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Literal

import tyro

from renet.bundle import MANIFEST, find_bundle
from renet.errors import RenetError
from renet.evaluation.live import EVERY, Pacer, Viewer, open_view
from renet.evaluation.results import output_folder
from renet.evaluation.rollout import FLAT, PARKOUR, Mode, Trial, check_finite, check_modes
from renet.faults import parse_fault
from renet.interface import CONTROL_DT, Engine, Terrain

if TYPE_CHECKING:
    from renet.evaluation.env import SimEnv


@dataclass(frozen=True)
class PlayCfg:
    """Watch one robot, once for each policy mode, and film them side by side.

    By default its camera is unplugged half a second before a gap of 37 cm.
    """

    bundle: tyro.conf.Positional[Path | None] = None
    """Bundle folder, or a checkpoint or run folder; or the name of a bundle that ships: go1-parkour
    (the default), go2-parkour."""
    out: Path | None = None
    """The film; results/play.mp4 by default."""
    terrain: Terrain | Literal["parkour"] = "gap"
    """Ground; parkour: all tiles at all levels."""
    level: int = 5
    """Level of the tile, 1 to 10."""
    scene: Path | None = None
    """Ground of your own instead: a height map (.npy in m, .png) or an MJCF scene (.xml)."""
    scene_width: float = 8.0
    """Metres that a height map is wide; of more than 8 it takes a piece."""
    scene_height: float = 0.3
    """Metres of white above black in a .png."""
    fault: tuple[str, ...] = ("unplugged@1.5s",)
    """Faults of the camera, NAME[:SEVERITY]@SECONDS[+DURATION], such as blackout:3@5s+2s; --fault
    alone: none."""
    modes: tuple[Mode, ...] = ("switch", "memory")
    """Policy modes to compare."""
    seconds: float = 8.0
    """Length of the film, simulated."""
    speed: float = 0.6
    """Commanded forward speed, m/s."""
    seed: int = 1
    """Seed of the robot's body, start and noise."""
    engine: Engine = "auto"
    """Physics engine, on the CPU; auto: native."""
    viewer: Viewer = "auto"
    """Where to watch: window (MuJoCo's; its last mode is solid, the others are transparent),
    browser (the last mode), or none; auto: a window where there is a display. Closing the window
    ends the walk; what was walked is filmed."""


@contextmanager
def opened(path: Path | None) -> Iterator[Path | None]:
    """A bundle's folder; a checkpoint is exported to one that lasts as long as the block.

    Raises RenetError for a folder that holds neither.
    """
    if path is not None and path.is_file():
        raise RenetError(f"{path} is a file, no bundle: `renet evaluate log` draws a recording")
    folder = None if path is None else find_bundle(path)
    if folder is None or (folder / MANIFEST).exists() or not folder.exists():
        yield folder
        return
    with TemporaryDirectory() as temporary:
        from renet.training.export import ExportCfg, export

        yield export(ExportCfg(checkpoint=folder, out=Path(temporary) / folder.name))


def run_play(cfg: PlayCfg) -> Path:
    """Drive and film the robots and return the film; raises RenetError for wrong settings."""
    out = cfg.out or Path("results/play.mp4")
    if out.suffix != ".mp4":
        raise RenetError(f"a film is an .mp4: give --out {out.name}.mp4, not {out.name}")
    check_finite(cfg)
    if cfg.seconds < 1.0:
        raise RenetError(f"a film needs at least one second, got {cfg.seconds}")
    check_modes(cfg.modes)
    faults = tuple(parse_fault(text) for text in cfg.fault)
    trials = [Trial(mode, faults) for mode in cfg.modes]
    rows, steps = range(len(trials)), round(cfg.seconds / CONTROL_DT)
    from renet.evaluation.evaluator import Evaluator
    from renet.evaluation.video import film

    with opened(cfg.bundle) as folder:
        evaluator = Evaluator(folder, cfg.engine)
        task = ground_of(cfg)
        output_folder(out.parent)
        env = evaluator.make_env(task, [0 for _ in rows], cfg.speed, cfg.seed)
        rollout = evaluator.rollout(env, trials, cfg.seed)
    ground = cfg.terrain if cfg.scene is None else cfg.scene.name
    with watching(cfg, env) as on_step:
        trace = rollout.run(steps, f"{ground}, {len(rows)} robots", film=rows, on_step=on_step)
    name = ", ".join(fault.fault for fault in faults)
    return film(out, env.scene_spec, trace, dict(enumerate(cfg.modes)), name)


def ground_of(cfg: PlayCfg) -> Any:
    """What to make the environment of; raises RenetError for a ground that cannot be."""
    from renet.tasks.terrains import own_ground
    from renet.terrain.own_ground import GroundFile

    if cfg.scene is not None:
        ground = GroundFile(file=cfg.scene, width=cfg.scene_width, height=cfg.scene_height)
        return own_ground(ground.tile(), cfg.level)
    return cfg.terrain if cfg.terrain in (FLAT, PARKOUR) else {cfg.terrain: cfg.level}


@contextmanager
def watching(cfg: PlayCfg, env: SimEnv) -> Iterator[Callable[[int], bool]]:
    """What to call after each control step, which shows the robots where somebody watches.

    It returns True once the window is closed.
    """
    view = open_view(cfg.viewer, env.scene_spec, cfg.modes)
    if view is None:
        yield lambda step: False
        return
    pacer, robots = Pacer(), range(len(cfg.modes))

    def on_step(step: int) -> bool:
        if step % EVERY == 0:
            view.show(env.poses(robots))
        pacer.wait(step)
        return view.closed

    try:
        yield on_step
    finally:
        view.close()
