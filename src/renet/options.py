"""Options of commands whose own modules need PyTorch: help and mistakes need not load it."""

import argparse
import math
import re
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, fields
from importlib.metadata import entry_points
from pathlib import Path

import tyro

from renet import plug_ins
from renet.errors import RenetError, demand_name
from renet.interface import Engine
from renet.settings_file import read_settings

ROBOT_NAMES = ("Go1", "Go2")
TASKS = tuple(
    f"Renet-{robot}-{kind}"
    for robot in ROBOT_NAMES
    for kind in ("Parkour", "Parkour-Paper", "Flat")
)
"""Ids of the tasks that renet itself registers, which needs PyTorch."""
FLAT_TASKS = tuple(task for task in TASKS if task.endswith("-Flat"))
"""Those on a plane, without tiles."""
NO_TILES = "the task has no tiles to put a scene among: train a Parkour task"
"""Message about a scene for a task on a plane."""
TASK = TASKS[0]
STARTED = time.monotonic()
"""Time of the monotonic clock at which this module was loaded, the first of a command, s."""
LATEST = "latest"
LOGS = Path("logs")
SETTINGS = ("--env.", "--agent.")
"""Beginnings of options that are settings of a task, known once it is loaded."""


@dataclass(kw_only=True)
class TrainOptions:
    """Options of a training that are no settings of its task."""

    task: tyro.conf.Positional[str]
    """Renet-Go1-Parkour (the recipe), Renet-Go1-Parkour-Paper (as in the paper),
    Renet-Go1-Flat, Renet-Go2-..., or a plug-in's."""
    film_every: int = 0
    """Iterations from one film of the run to the next; 0: none."""
    config: Path | None = None
    """A run's config.json or a part of it, as JSON or YAML; other options win over it."""
    num_envs: int | None = None
    """Robots of each process; by default 512 on a CPU, 4096 on a GPU (paper)."""
    resume: str | None = None
    """Run folder or checkpoint to go on from, with its settings; latest: the task's newest run."""
    time_budget: str | None = None
    """Stop with a checkpoint before the command has run for so long (90s, 25m, 8h)."""
    log_root: Path | None = None
    """Folder of runs, by default logs; with --resume another one leaves that run as it is."""
    device: str = "auto"
    """cpu, cuda:0, ... or auto (a GPU if there is one)."""
    engine: Engine = "auto"
    """Physics engine; auto: native (C MuJoCo on threads) on a CPU, warp on a GPU."""
    scene: Path | None = None
    """Ground of your own, too: a height map (.npy in m, .png) or an MJCF scene (.xml)."""
    scene_width: float = 8.0
    """Width of a height map, m."""
    scene_height: float = 0.3
    """Height of white above black in a .png, m."""
    scene_share: float = 0.5
    """Share of the robots on your own ground; 1: no other tiles."""


@dataclass(kw_only=True)
class UsualOptions(TrainOptions):
    """Train a policy. A task's settings are options, too: --agent.NAME and --env.NAME.

    `renet train TASK --help-all` lists them, `renet recipe` prints their values.
    """

    seed: int = 1
    """Seed of everything random."""
    max_iterations: int = 15_000
    """Iterations in all, also of a run that goes on; the paper's by default."""

    @staticmethod
    def known(arguments: Sequence[str]) -> list[str]:
        """Return the arguments without a task's settings.

        Raises:
            RenetError: There is no such option.
        """
        # The first field is the task, which is positional.
        options = [f"--{field.name.replace('_', '-')}" for field in fields(UsualOptions)[1:]]
        options += ["--help", "--help-all"]
        kept = []
        is_setting = False
        for argument in arguments:
            # Arguments that follow an option are its values.
            if argument.startswith("--"):
                name = argument.partition("=")[0]
                is_setting = name.startswith(SETTINGS)
                if not is_setting:
                    demand_name("option", name.replace("_", "-"), options)
            if not is_setting:
                kept.append(argument)
        return kept

    @staticmethod
    def task_of(arguments: Sequence[str]) -> str:
        """Return the task that a command line names, before or after options; empty for none.

        Raises as `known`.
        """
        parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
        for option in fields(UsualOptions)[1:]:
            name = option.name
            parser.add_argument(*{f"--{name.replace('_', '-')}", f"--{name}"}, nargs="?")
        # argparse would take a task that follows options for none, if it knew of one.
        _, others = parser.parse_known_args(UsualOptions.known(arguments))
        return next((argument for argument in others if not argument.startswith("-")), "")

    @classmethod
    def defaults(cls, arguments: Sequence[str]) -> "UsualOptions":
        """Return the options that a command line changes."""
        named = {argument.partition("=")[0] for argument in arguments}
        # A resumed run, or a file, states the task, which need not be on the command line then.
        return cls(task="" if named & {"--resume", "--config"} else tyro.MISSING)

    def check(self) -> None:
        """Raise RenetError for options that are wrong for any task and any computer."""
        task = self.task
        if self.config is not None:
            if self.resume is not None:
                raise RenetError(
                    "a run that goes on has its own settings: drop --config and change them by"
                    " options, or begin a run without --resume"
                )
            stored = read_settings(self.config).get("task", "")
            if not (task or stored):
                raise RenetError(f"{self.config} names no task: renet train TASK --config FILE")
            task = task or str(stored)
        if task:
            check_task(task)
        if self.resume is not None:
            resumed_folder(self.resume, self.log_root, self.task)
        if self.num_envs is not None and self.num_envs < 1:
            raise RenetError(f"the number of environments must be at least 1, got {self.num_envs}")
        check_seed(self.seed)
        if self.film_every < 0:
            raise RenetError(f"--film-every must not be negative, got {self.film_every}")
        seconds(self.time_budget)
        check_device(self.device)
        if self.scene is not None:
            check_scene(self.scene, self.scene_share, task)


def check_seed(seed: int) -> None:
    """Raise RenetError for a seed that a generator cannot take; mjlab draws one for -1."""
    # NumPy's legacy generator takes no other seeds.
    if not -1 <= seed < 2**32:
        raise RenetError(f"seed must be from 0 to 2^32 - 1, got {seed}")


def check_scene(scene: Path, share: float, task: str) -> None:
    """Raise RenetError for a scene that is missing, or that a task or a share cannot have."""
    if task in FLAT_TASKS:
        raise RenetError(NO_TILES)
    check_share(share)
    if not scene.exists():
        raise RenetError(f"there is no scene {scene}")


def check_share(share: float) -> None:
    """Raise RenetError for a share of robots on a scene that is out of its range."""
    if not 0.0 < share <= 1.0:
        raise RenetError(f"--scene-share must be above 0 and at most 1, got {share:g}")


def check_task(task: str) -> None:
    """Raise RenetError for a task that neither renet nor a plug-in can have registered."""
    others = [p for p in entry_points(group=plug_ins.TASKS) if p.value != plug_ins.REGISTRY]
    # Once mjlab is loaded, a program may have registered a task by itself.
    if not (others or "mjlab" in sys.modules or task.startswith("Mjlab-")):
        demand_name("task", task, TASKS)


def resumed_folder(resume: str, root: Path | None, task: str) -> Path:
    """Return the folder that `--resume` names.

    Args:
        resume: Value of the option: a folder, or latest.
        root: Folder of all runs, by default `LOGS`.
        task: Task whose newest run `latest` means.

    Raises:
        RenetError: There is no such folder.
    """
    if resume == LATEST and not task:
        raise RenetError("write the task first: renet train TASK --resume latest")
    folder = (root or LOGS) / task if resume == LATEST else Path(resume)
    if not folder.exists():
        raise RenetError(f"nothing to resume: {folder} does not exist")
    return folder


def seconds(text: str | None) -> float:
    """Parse a duration such as 90s, 25m or 1.5h to s; a number alone is in s, None is infinite."""
    if text is None:
        return math.inf
    match = re.fullmatch(r"(\d+(?:\.\d+)?)([smh]?)", text.strip())
    if not match:
        raise RenetError(f"time budget {text!r} is not a duration: write 90s, 25m or 8h")
    return float(match[1]) * {"": 1, "s": 1, "m": 60, "h": 3600}[match[2]]


def check_device(name: str) -> None:
    """Raise RenetError for a device that no computer has."""
    if not re.fullmatch(r"auto|cpu|cuda(:\d+)?", name):
        raise RenetError(f"unknown device {name!r}: use cpu, cuda or cuda:N")


@dataclass(kw_only=True)
class RecipeCfg:
    """Print how a checkpoint was trained, or how `renet train` would begin now, as JSON."""

    checkpoint: tyro.conf.Positional[Path | None] = None
    """Checkpoint, or a run folder whose newest checkpoint is taken; by default, the recipe of a run
    that would begin now."""
    task: str = TASK
    """Task of the run that would begin now."""

    def check(self) -> None:
        """Raise RenetError for a task that nothing can have registered."""
        check_task(self.task)


@dataclass(kw_only=True)
class ExportCfg:
    """Turn a checkpoint into a bundle: three ONNX models and a manifest."""

    checkpoint: tyro.conf.Positional[Path]
    """Checkpoint folder, or a run folder whose newest checkpoint is taken."""
    out: Path = Path("bundle")
    """Folder of the bundle; replaced if it already is one."""
    beta: float = 0.01
    """Selector threshold until `renet calibrate` measures one."""
