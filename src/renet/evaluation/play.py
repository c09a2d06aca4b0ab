"""`renet play`: a film of a bundle or a checkpoint on any tile."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

import tyro

from renet.bundle import MANIFEST
from renet.errors import RenetError
from renet.evaluation.results import output_folder
from renet.evaluation.rollout import FLAT, PARKOUR, Mode, Trial, check_finite, check_modes
from renet.faults import parse_fault
from renet.interface import CONTROL_DT, Engine, Terrain


@dataclass(frozen=True)
class PlayCfg:
    """Film one robot, once for each policy mode, side by side."""

    bundle: tyro.conf.Positional[Path | None] = None
    """Bundle folder, or a checkpoint or run folder; or the name of a bundle that ships: go1-parkour
    (the default), go2-parkour."""
    out: Path | None = None
    """The film; results/play.mp4 by default."""
    terrain: Terrain | Literal["parkour"] = "flat"
    """Ground; parkour: all tiles at all levels."""
    level: int = 1
    """Level of the tile, 1 to 10."""
    fault: tuple[str, ...] = ()
    """Faults of the camera, NAME[:SEVERITY]@SECONDS[+DURATION], such as blackout:3@5s+2s."""
    modes: tuple[Mode, ...] = ("camera", "memory")
    """Policy modes to compare."""
    seconds: float = 8.0
    """Length of the film, simulated."""
    speed: float = 0.6
    """Commanded forward speed, m/s."""
    seed: int = 1
    """Seed of the robot's body, start and noise."""
    engine: Engine = "auto"
    """Physics engine, on the CPU; auto: native."""


@contextmanager
def opened(path: Path | None) -> Iterator[Path | None]:
    """A bundle's folder; a checkpoint is exported to one that lasts as long as the block.

    Raises RenetError for a folder that holds neither.
    """
    if path is not None and path.is_file():
        raise RenetError(f"{path} is a file, no bundle: `renet evaluate log` draws a recording")
    if path is None or (path / MANIFEST).exists() or not path.exists():
        yield path
        return
    with TemporaryDirectory() as folder:
        from renet.training.export import ExportCfg, export

        yield export(ExportCfg(checkpoint=path, out=Path(folder) / path.name))


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
    from renet.evaluation.report.video import film

    with opened(cfg.bundle) as folder:
        evaluator = Evaluator(folder, cfg.engine)
        task = cfg.terrain if cfg.terrain in (FLAT, PARKOUR) else {cfg.terrain: cfg.level}
        output_folder(out.parent)
        env = evaluator.make_env(task, [0 for _ in rows], cfg.speed, cfg.seed)
        rollout = evaluator.rollout(env, trials, cfg.seed)
    trace = rollout.run(steps, f"{cfg.terrain}, {len(rows)} robots", film=rows)
    name = ", ".join(fault.fault for fault in faults)
    return film(out, env.scene_spec, trace, dict(enumerate(cfg.modes)), name)
