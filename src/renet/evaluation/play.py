"""`renet play`: a film of a bundle or a checkpoint on any tile."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Literal

import numpy as np
import tyro

from renet.bundle import MANIFEST
from renet.errors import RenetError
from renet.evaluation.results import output_folder
from renet.evaluation.rollout import Mode, Rollout, Trial, check_finite, check_modes
from renet.evaluation.trace import UPDATES_PER_STEP
from renet.faults import parse_fault
from renet.interface import CONTROL_DT, Engine, SelectorName, Terrain
from renet.selector.monitors import SelectorInput

if TYPE_CHECKING:
    from renet.evaluation.env import SimEnv


@dataclass(frozen=True)
class PlayCfg:
    """Film one robot, once for each policy mode, side by side."""

    bundle: tyro.conf.Positional[Path | None] = None
    """Bundle folder, or a checkpoint or run folder; the bundle that ships with renet by default."""
    out: Path | None = None
    """The film; results/play.mp4 by default."""
    terrain: Terrain | Literal["parkour"] = "flat"
    """Ground; parkour: all tiles at all levels."""
    level: int = 1
    """Level of the tile, 1 to 10."""
    fault: tuple[str, ...] = ()
    """Faults of the camera, NAME[:SEVERITY]@SECONDS[+DURATION], such as blackout:3@5s+2s."""
    modes: tuple[Mode, ...] = ("vp", "renet")
    """Policy modes to compare."""
    seconds: float = 8.0
    """Length of the film, simulated."""
    speed: float = 0.6
    """Commanded forward speed, m/s."""
    seed: int = 1
    """Seed of the robot's body, start and noise."""
    selector: SelectorName = "monitors"
    """monitors: all of them, slow to trust again; paper: the reconstruction loss against beta."""
    engine: Engine = "auto"
    """Physics engine; auto: native on a CPU, warp on a GPU."""


@contextmanager
def opened(path: Path | None) -> Iterator[Path | None]:
    """A bundle's folder; a checkpoint is exported to one that lasts as long as the block.

    Raises:
        RenetError: a folder that holds neither.
    """
    if path is not None and path.is_file():
        raise RenetError(f"{path} is a file, no bundle: `renet evaluate log` draws a recording")
    if path is None or (path / MANIFEST).exists() or not path.exists():
        yield path
        return
    with TemporaryDirectory() as folder:
        from renet.training.export import ExportCfg, export

        yield export(ExportCfg(checkpoint=path, out=Path(folder) / path.name))


def keep_maps(rollout: Rollout, env: SimEnv) -> list[np.ndarray]:
    """Let a rollout keep the robots' height maps, predicted and true.

    Returns:
        A list that every control step of the rollout extends by [N, 2, 132] m: the VP estimator's
        map, then the terrain's.
    """
    from renet.tasks.sensors import HEIGHT_MAP

    maps, sensor, updates = [], env.env.scene[HEIGHT_MAP], count()

    def keep(seen: SelectorInput) -> None:
        if next(updates) % UPDATES_PER_STEP == 0:
            maps.append(np.stack((rollout.policy.height_map, sensor.data.numpy()), axis=1))

    rollout.on_update = keep
    return maps


def run_play(cfg: PlayCfg) -> Path:
    """Drive the robots, film them and return the film.

    Raises:
        RenetError: unknown terrain, fault or mode, or a bundle that cannot be used.
    """
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
    from renet.evaluation.report.video import VideoCfg, film

    with opened(cfg.bundle) as folder:
        evaluator = Evaluator(folder, cfg.engine, cfg.selector)
        task = evaluator.terrain_env_cfg(cfg.terrain, cfg.level)
        output_folder(out.parent)
        env = evaluator.make_env(task, [0 for _ in rows], cfg.speed, cfg.seed)
        rollout = evaluator.rollout(env, trials, cfg.seed)
    maps = keep_maps(rollout, env)
    trace = rollout.run(steps, f"{cfg.terrain}, {len(rows)} robots", film=rows)
    titles, name = dict(enumerate(cfg.modes)), ", ".join(fault.fault for fault in faults)
    return film(out, env.scene_spec, trace, titles, name, VideoCfg(), np.stack(maps))
