"""Films of a policy whose camera fails, on any ground: `renet play`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Literal

import tyro

from renet.bundle import MANIFEST, find_bundle
from renet.errors import RenetError
from renet.evaluation.adapters.options import PolicyOptions
from renet.evaluation.benchmark.modes import HEALTHY
from renet.evaluation.live import STEPS_PER_PICTURE, Pacer, Viewer, open_view
from renet.evaluation.results import output_folder
from renet.evaluation.rollout import Trial
from renet.evaluation.settings import FLAT_GROUND, PARKOUR, StudyMode, check_finite, check_modes
from renet.faults import parse_fault
from renet.interface import Engine, Terrain, control_steps

if TYPE_CHECKING:
    from renet.evaluation.env import SimEnv
    from renet.evaluation.evaluator import Evaluator, Task

DEFAULT_MODES = ("switch", "memory")
"""Modes of a bundle that are compared by default."""


@dataclass(frozen=True)
class PlayCfg(PolicyOptions):
    """Watch a robot in each of several policy modes, and film them side by side.

    By default its camera is unplugged half a second before a gap of 37 cm.
    """

    bundle: tyro.conf.Positional[Path | None] = None
    """Bundle folder, or a checkpoint or run folder; or the name of a bundle that comes with renet:
    go1-parkour (the default), go1-driven, go2-parkour, go2-driven; or hf://OWNER/NAME on the
    Hugging Face Hub."""
    out: Path = Path("results/play.mp4")
    """The film."""
    terrain: Terrain | Literal["parkour"] = "gap"
    """Ground; parkour: all tiles at all levels."""
    level: int = 5
    """Level of the tile, 1 to 10."""
    scene: Path | None = None
    """Ground of your own instead: a height map (.npy in m, .png) or an MJCF scene (.xml)."""
    scene_width: float = 8.0
    """Width of a height map, m; of a map wider than 8 m a piece is taken."""
    scene_height: float = 0.3
    """Height of white above black in a .png, m."""
    fault: tuple[str, ...] = ("unplugged@1.5s",)
    """Faults of the camera, NAME[:SEVERITY]@SECONDS[+DURATION], such as blackout:3@5s+2s; none with
    --fault alone."""
    modes: tuple[StudyMode, ...] = ()
    """Policy modes to compare; by default switch and memory. A policy with an adapter walks as
    camera and, beside it, as healthy, with a camera that never fails; or as blind if it reads no
    image."""
    seconds: float = 8.0
    """Simulated time, s."""
    speed: float = 0.6
    """Commanded forward speed, m/s."""
    seed: int = 1
    """Seed of the robot's body, start and noise."""
    engine: Engine = "auto"
    """Physics engine, on the CPU; auto: native."""
    viewer: Viewer = "auto"
    """Live view: window (MuJoCo's viewer; the last mode is solid, the others are transparent),
    browser (the last mode), or none; auto: a window if there is a display. Closing the window ends
    the run; the film shows it up to then."""


def _use_of(path: Path) -> str:
    """Say which command takes a file that is no bundle."""
    if path.suffix in (".onnx", ".pt"):
        return "`renet play --policy FILE --adapter NAME` walks a policy"
    return "`renet evaluate log` draws a recording"


@contextmanager
def bundle_folder(path: Path | None) -> Iterator[Path | None]:
    """Context with a bundle's folder; for a checkpoint, one that lasts as long as the block.

    Raises RenetError for a folder that holds neither.
    """
    if path is not None and path.is_file():
        raise RenetError(f"{path} is a file, no bundle: {_use_of(path)}")
    folder = None if path is None else find_bundle(path)
    # A folder without manifest is a checkpoint or a run; a missing one fails when it is loaded.
    if folder is None or (folder / MANIFEST).exists() or not folder.exists():
        yield folder
        return
    with TemporaryDirectory() as temporary:
        from renet.training.export import ExportCfg, export

        yield export(ExportCfg(checkpoint=folder, out=Path(temporary) / folder.name))


@contextmanager
def open_evaluator(cfg: PlayCfg) -> Iterator[tuple[Evaluator, Mapping[str, str]]]:
    """Context with the settings' evaluator, and the rollout's mode of each robot by its title.

    Raises RenetError for a bundle or a policy that cannot be used.
    """
    adapted = cfg.open_policy(cfg.engine)
    if adapted is not None:
        # The last robot is the one that a live view shows best: the one whose camera fails.
        yield adapted, dict(reversed(adapted.entries.items()))
        return
    from renet.evaluation.evaluator import Evaluator

    with bundle_folder(cfg.bundle) as folder:
        modes = cfg.modes or DEFAULT_MODES
        # A film shows the fault, not what else differs between robots.
        evaluator = Evaluator(folder, cfg.engine, conditions="nominal")
        yield evaluator, dict(zip(modes, modes, strict=True))


def check_play(cfg: PlayCfg) -> None:
    """Raise RenetError for settings that no film can have."""
    name = cfg.out.name
    if cfg.out.suffix.lower() != ".mp4":
        raise RenetError(f"a film is an .mp4: give --out {name}.mp4, not {name}")
    if cfg.out.is_dir():
        raise RenetError(f"{cfg.out} is a folder: give --out the name of a film in it")
    check_finite(cfg)
    if cfg.seconds < 1.0:
        raise RenetError(f"a film needs at least one second, got {cfg.seconds}")
    cfg.check_policy(cfg.bundle)
    if cfg.policy is not None and cfg.modes:
        raise RenetError(
            "a policy with an adapter has no modes: leave out --modes, which choose among a"
            " bundle's models"
        )
    if cfg.modes:
        check_modes(cfg.modes)


def run_play(cfg: PlayCfg) -> Path:
    """Run and film the robots and return the film's path; raises RenetError for wrong settings."""
    check_play(cfg)
    faults = tuple(map(parse_fault, cfg.fault))
    steps = control_steps(cfg.seconds)
    # These imports take seconds; wrong settings fail before them.
    from renet.evaluation.video import film, pictures

    with open_evaluator(cfg) as (evaluator, modes):
        trials = []
        for title, mode in modes.items():
            trials.append(Trial(mode, () if title == HEALTHY else faults))
        rows = range(len(trials))
        task = ground_of(cfg)
        output_folder(cfg.out.parent)
        # All robots are twins.
        env = evaluator.make_env(task, [0] * len(rows), cfg.speed, cfg.seed)
        rollout = evaluator.rollout(env, trials, cfg.seed)
    titles = list(modes)
    ground = cfg.terrain if cfg.scene is None else cfg.scene.name
    with watching(cfg, env, titles) as on_step:
        trace = rollout.run(steps, f"{ground}, {len(rows)} robots", film=rows, on_step=on_step)
    name = ", ".join(fault.fault for fault in faults)
    return film(cfg.out, pictures(env.scene_spec, trace, dict(enumerate(titles)), name))


def ground_of(cfg: PlayCfg) -> Task:
    """Return the task for `Evaluator.make_env`; raises RenetError if it cannot be built."""
    from renet.tasks.terrains import own_ground
    from renet.terrain.own_ground import GroundFile

    if cfg.scene is not None:
        ground = GroundFile(file=cfg.scene, width=cfg.scene_width, height=cfg.scene_height)
        return own_ground(ground.tile(), cfg.level)
    return cfg.terrain if cfg.terrain in (FLAT_GROUND, PARKOUR) else {cfg.terrain: cfg.level}


@contextmanager
def watching(cfg: PlayCfg, env: SimEnv, titles: Sequence[str]) -> Iterator[Callable[[int], bool]]:
    """Context with a function to call after each control step, which updates the live view.

    It returns True once the window is closed.

    Args:
        cfg: Settings with the place of the view.
        env: Environment of the robots, whose titles are [N].
    """
    view = open_view(cfg.viewer, env.scene_spec, titles)
    if view is None:
        yield lambda step: False
        return
    pacer = Pacer()
    robots = range(len(titles))

    def on_step(step: int) -> bool:
        if step % STEPS_PER_PICTURE == 0:
            view.show(env.poses(robots))
        pacer.wait(step)
        return view.closed

    # The window closes after errors, too.
    try:
        yield on_step
    finally:
        view.close()
