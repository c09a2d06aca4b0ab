"""`renet train`: one process, or one per GPU; and `renet recipe`, which says how."""

import argparse
import json
import math
import os
import sys
import time
import warnings
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, redirect_stdout
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Self, cast

import mjlab
import torch
import tyro
from mjlab.rl import RslRlVecEnvWrapper
from mjlab.tasks.registry import load_rl_cfg, load_runner_cls
from rich.console import Console

from renet.curves import CURVES
from renet.errors import RenetError, printable
from renet.files import write_atomically
from renet.folders import lock
from renet.options import TASK, RecipeCfg, TrainOptions, check_device, seconds
from renet.settings_file import read_settings
from renet.tasks import RenetEnvCfg, env_cfg, make_env
from renet.tasks.terrains import add_own_ground
from renet.terrain.own_ground import GroundFile
from renet.training import checkpoint as checkpoints
from renet.training.config import MOST_STEPS, RenetRunnerCfg, steps_per_env
from renet.training.configuration import PARTS, configured, options_of, task_of
from renet.training.films import Films, filming
from renet.training.metrics import write_run_report
from renet.training.progress import Report
from renet.training.provenance import differences, restore, to_json
from renet.training.runner import RenetRunner
from renet.training.runs import new_run, resolve_resume, resumed_run, signals
from renet.version import code_version

CONFIG = "config.json"
"""File of a run's folder that says how it was trained, of the newest start."""


@dataclass(kw_only=True)
class TrainCfg(TrainOptions):
    """Train RENet. On a CPU the native engine steps C MuJoCo; on a GPU MuJoCo Warp.

    A task is registered with both its configurations, `--agent` and `--env`; options are those of
    mjlab's `train`, which trains the same. `training/recipe.py` says how ours depart from the
    paper's. Several GPUs: torchrun or Slurm start a process for each (docs/train.md).
    """

    agent: RenetRunnerCfg
    """Networks and learning."""
    env: RenetEnvCfg
    """The task: scene, rewards, curriculum and so on, in mjlab's words."""

    tyro_flags: ClassVar = mjlab.TYRO_FLAGS

    def __post_init__(self) -> None:
        if self.num_envs is not None:
            self.env.scene.num_envs = self.num_envs
        if self.scene is not None:
            ground = GroundFile(file=self.scene, width=self.scene_width, height=self.scene_height)
            add_own_ground(self.env.scene.terrain, ground.tile(), self.scene_share)

    @classmethod
    def from_task(cls, task: str, **options: Any) -> Self:
        """The settings that a task was registered with; raises RenetError for an unknown one."""
        env = env_cfg(task)
        agent = load_rl_cfg(task)
        if not isinstance(agent, RenetRunnerCfg):
            raise RenetError(f"{task} is not trained by renet: its agent is of another class")
        return cls(task=task, env=env, agent=agent, **options)

    @classmethod
    def defaults(cls, arguments: Sequence[str]) -> Self:
        """What a command line starts from: its task, a file, or the run it resumes.

        Raises RenetError.
        """
        parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
        parser.add_argument("--resume", nargs="?", const="")
        parser.add_argument("--log-root", "--log_root", nargs="?", type=Path)
        parser.add_argument("--config", nargs="?", type=Path)
        paths, _ = parser.parse_known_args(arguments)
        task = next((a for a in arguments[:1] if not a.startswith("-")), "")
        if paths.resume is not None:
            path = resolve_resume(paths.resume, paths.log_root, task)
            return cls.resumed(checkpoints.load_state(path), task)
        if paths.config is not None:
            return cls.from_file(paths.config, task)
        return cls.from_task(task) if task else replace(cls.from_task(TASK), task=tyro.MISSING)

    @classmethod
    def from_file(cls, path: Path, task: str = "") -> Self:
        """The settings of a task, by default the file's, with what a file says of them.

        Raises RenetError for a file that cannot be read or says what the task has not.
        """
        settings = read_settings(path)
        options = options_of(settings, path)
        robots = options.pop("num_envs", None)
        cfg = cls.from_task(task_of(settings, path, task), **options)
        for part in PARTS:
            if part in settings:
                changed = configured(getattr(cfg, part), settings[part], part)
                setattr(cfg, part, changed)
        # In its own place, where the command line can still change it.
        if robots is not None:
            cfg.env.scene.num_envs = robots
        return cfg

    @classmethod
    def resumed(cls, state: dict[str, Any], task: str = "") -> Self:
        """The settings in a checkpoint's state; those of the code for what it does not say.

        The task is by default the checkpoint's; another one brings rules of its own.
        """
        cfg = cls.from_task(task or str(state.get("task", "")))
        stored = state["env"]
        if cfg.task != state.get("task"):
            stored = {"scene": {"num_envs": stored.get("scene", {}).get("num_envs")}}
        agent = restore(cfg.agent, state["agent"], "agent")
        agent = replace(agent, task=cfg.task, experiment_name=cfg.agent.experiment_name)
        return replace(cfg, env=restore(cfg.env, stored, "env"), agent=agent)


def train(cfg: TrainCfg) -> Path | None:
    """Train and return the run folder (None on ranks above 0).

    Under torchrun (or any launcher that sets RANK, LOCAL_RANK and WORLD_SIZE) each process trains
    its own robots and gradients are averaged. After Ctrl-C or TERM training stops with a
    checkpoint; the next one interrupts at once.

    Raises:
        RenetError: anything a user can put right.
        SystemExit: a signal stopped it.
    """
    deadline = time.monotonic() + seconds(cfg.time_budget)
    agent, rank = cfg.agent, int(os.getenv("RANK", "0"))
    device = resolve_device(cfg.device)
    if device != "cpu":  # Before mjlab wraps Warp's streams: as those of the current device.
        torch.cuda.set_device(device)
    path, state = checkpoint_of(cfg)
    runner: RenetRunner | None = None

    def stop(number: int) -> None:
        if runner is None:
            raise KeyboardInterrupt
        runner.stop.set()
        received.append(number)
        console.print("Stopping with a checkpoint; Ctrl-C again interrupts at once")

    received: list[int] = []
    with ExitStack() as stack:
        console = stack.enter_context(quiet(rank))
        stack.enter_context(signals(stop))
        # Another task's run stays as it is.
        run = resumed_run(path if state.get("task") == cfg.task else None, cfg.log_root)
        if run and not rank:
            stack.enter_context(lock(run))
        env = make_vec_env(cfg, device, rank)
        stack.callback(env.close)
        if not run and not rank:
            run = new_run(cfg.log_root, agent.experiment_name, agent.run_name)
            stack.enter_context(lock(run))
        runner_cls = cast(type[RenetRunner], load_runner_cls(cfg.task))
        built = runner_cls(env, asdict(agent), None if rank else str(run), device)
        if path:
            built.load(str(path))
            console.print(f"Going on from {path} ({built.alg.steps / 1e6:.2f} M steps)")
        settings = built.provenance()
        for part in ("agent", "env", "code"):
            for line in differences(state.get(part, settings[part]), settings[part], part):
                console.print(printable(line))
        if not rank and run:
            console.print(f"Training {cfg.task} with {env.num_envs} robots in {run}")
            console.print(iterations(agent, env.num_envs, built.alg.steps))
            write_atomically(run / CONFIG, (json.dumps(settings, indent=1) + "\n").encode())
        runner = built
        with (
            filming(films_of(cfg, run, console), deadline, received) as film,
            Report(console, runner, agent.max_iterations, deadline) as report,
        ):
            left = agent.max_iterations - runner.alg.iteration
            budget = deadline - time.monotonic()
            newest = runner.learn(
                left, time_budget_s=budget, report=lambda: (report.iterate(), film())
            )
        if rank or run is None:
            return None
        if (run / CURVES).exists():
            console.print(f"Curves: {write_run_report(run)}")
        if received:
            console.print(f"Stopped at {newest}: renet train {cfg.task} --resume {run} goes on")
            raise SystemExit(128 + received[0])
    return run


def films_of(cfg: TrainCfg, run: Path | None, console: Console) -> Films | None:
    """What films a run; None where nobody wants it, or on ranks above 0."""
    if not cfg.film_every or run is None:
        return None
    terrain = cfg.env.scene.terrain
    tiles = terrain is not None and terrain.terrain_generator is not None
    return Films(run, cfg.film_every, tiles, console.print)


def iterations(agent: RenetRunnerCfg, robots: int, steps: int) -> str:
    """What iterations are in a run that has taken so many environment steps, in words."""
    fixed, batch = agent.num_steps_per_env, agent.batch_size
    now, later = (steps_per_env(fixed, batch, robots, at) for at in (steps, math.inf))
    line = f"Each robot takes {now:,} control steps in an iteration"
    line += f", later {later:,}" if later != now else ""
    capped = fixed is None and later == MOST_STEPS
    return f"{line}, the most there are: take more robots for larger batches" if capped else line


def checkpoint_of(cfg: TrainCfg) -> tuple[Path | None, dict[str, Any]]:
    """The checkpoint to go on from, and its state, which is empty where a new run begins.

    Raises RenetError where there is none, or it has all iterations behind it.
    """
    if cfg.resume is None:
        return None, {}
    path = resolve_resume(cfg.resume, cfg.log_root, cfg.agent.experiment_name)
    state = checkpoints.load_state(path)
    if state.get("iteration", 0) >= cfg.agent.max_iterations:
        raise RenetError(
            f"{path} is at iteration {state['iteration']}: --max-iterations counts from "
            "the very first one and must be above that"
        )
    return path, state


def make_vec_env(cfg: TrainCfg, device: str, rank: int = 0) -> RslRlVecEnvWrapper:
    """The task's environments as rsl_rl takes them; each rank has a seed of its own."""
    robots, seed = cfg.env.scene.num_envs, cfg.agent.seed + rank
    with warnings.catch_warnings(action="ignore"):  # mjlab warns of its own randomisation.
        env = make_env(cfg.env, robots, device, seed, cfg.engine)
    return RslRlVecEnvWrapper(env, clip_actions=cfg.agent.clip_actions)


@contextmanager
def quiet(rank: int = 0) -> Iterator[Console]:
    """A console on standard output, where mjlab's and rsl_rl's tables do not appear meanwhile.

    On ranks above 0 nothing does.
    """
    shown = sys.stdout
    with open(os.devnull, "w") as nowhere, redirect_stdout(nowhere):
        file = nowhere if rank else shown
        yield Console(file=file, markup=False, highlight=False, soft_wrap=True)


def resolve_device(name: str) -> str:
    """Turn `auto` and `cuda` into this process's device and refuse one that is absent."""
    check_device(name)
    if name == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    if name == "cuda":
        name = f"cuda:{os.getenv('LOCAL_RANK', '0')}"
    if name != "cpu" and int(name.removeprefix("cuda:")) >= torch.cuda.device_count():
        raise RenetError(
            f"device {name} is absent: {torch.cuda.device_count()} CUDA devices are visible; "
            "start fewer processes, use --device cpu, or cuda:0 where each process sees its own GPU"
        )
    return name


def show(cfg: RecipeCfg) -> None:
    """Print task, both configurations and the code's version; raises RenetError without any."""
    if cfg.checkpoint is not None:
        settings = checkpoints.load_state(checkpoints.find(cfg.checkpoint))
    else:
        run = TrainCfg.from_task(cfg.task)
        configurations = to_json({"agent": run.agent, "env": run.env})
        settings = {"task": cfg.task, **configurations, "code": code_version()}
    print(json.dumps(settings, indent=1))
