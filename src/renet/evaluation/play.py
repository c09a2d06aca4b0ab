"""`renet play`: a film of a bundle or a checkpoint on any tile."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Literal

import numpy as np
import tyro

from renet.bundle import MANIFEST
from renet.errors import RenetError
from renet.evaluation.results import output_folder
from renet.evaluation.rollout import UPDATES_PER_STEP, Trial, check_finite, check_modes
from renet.faults import parse_fault
from renet.interface import CONTROL_DT, Engine, SelectorName, Terrain
from renet.selector.monitors import SelectorInput

if TYPE_CHECKING:
    from renet.bundle.policy import Policy
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
    modes: tuple[str, ...] = ("vp", "renet")
    """Policy modes to compare: vp, renet, op, paper, oracle-switch."""
    seconds: float = 8.0
    """Length of the film, simulated."""
    speed: float = 0.6
    """Commanded forward speed, m/s."""
    seed: int = 1
    """Of the robot's body, start and noise."""
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


class MapLog:
    """Height maps of all robots at each control step of a rollout, predicted and true."""

    def __init__(self, policy: Policy, env: SimEnv) -> None:
        from renet.tasks.sensors import HEIGHT_MAP

        self._policy, self._sensor = policy, env.env.scene[HEIGHT_MAP]
        self._calls, self._maps = 0, []

    def note(self, seen: SelectorInput) -> None:
        """To be called at every update of the selector."""
        del seen
        if self._calls % UPDATES_PER_STEP == 0:
            true = self._sensor.data.numpy()
            self._maps.append(np.stack((self._policy.height_map, true), axis=1))
        self._calls += 1

    @property
    def maps(self) -> np.ndarray:
        """[T, N, 2, 132] m: the VP estimator's, then the terrain's."""
        return np.stack(self._maps)


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
    count, steps = len(trials), round(cfg.seconds / CONTROL_DT)
    from renet.bundle.policy import Policy
    from renet.evaluation.evaluator import Evaluator
    from renet.evaluation.report.video import VideoCfg, film

    with opened(cfg.bundle) as folder:
        evaluator = Evaluator(folder, cfg.engine, cfg.selector)
        task = evaluator.terrain_env_cfg(cfg.terrain, cfg.level)
        output_folder(out.parent)
        env = evaluator.make_env(task, [0] * count, cfg.speed, cfg.seed)
        policy = Policy(evaluator.bundle, count)
    log, title = MapLog(policy, env), f"{cfg.terrain}, {count} robots"
    trace = evaluator.rollout(
        title, env, trials, steps, cfg.seed, policy=policy, film=range(count), on_update=log.note
    )
    titles, name = dict(enumerate(cfg.modes)), ", ".join(fault.fault for fault in faults)
    return film(out, env.scene_spec, trace, titles, name, VideoCfg(), log.maps)
