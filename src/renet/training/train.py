"""The commands `renet train` and `renet recipe`, which prints all settings of a training."""

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
from typing import Any, ClassVar, Self, TextIO, cast

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
from renet.options import (
    STARTED,
    TASK,
    RecipeCfg,
    TrainOptions,
    UsualOptions,
    check_device,
    resumed_folder,
    seconds,
)
from renet.settings_file import read_settings
from renet.tasks import RenetEnvCfg, env_cfg, make_env, stored_env_cfg
from renet.tasks.terrains import add_own_ground
from renet.terminal import LastingOutput
from renet.terrain.own_ground import GroundFile
from renet.training import checkpoint as checkpoints
from renet.training.config import MOST_STEPS, RenetRunnerCfg, steps_per_env
from renet.training.config_file import PARTS, configured, options_of, task_of
from renet.training.films import Films, filming
from renet.training.metrics import write_run_report
from renet.training.progress import Report
from renet.training.provenance import differences, restore, to_json
from renet.training.runner import RenetRunner
from renet.training.runs import new_run, resumed_run, signals
from renet.version import code_version

CONFIG_FILE = "config.json"
"""File in a run's folder with all settings of its newest start."""


@dataclass(kw_only=True)
class TrainCfg(TrainOptions):
    """Train a policy. On a CPU the native engine steps C MuJoCo; on a GPU MuJoCo Warp.

    A task is registered with two configurations, whose settings are options `--agent...` and
    `--env...`. mjlab's own `train` takes the same options and trains the same. The recipe's
    departures from the paper are in `training/recipe.py`. On several GPUs, torchrun or Slurm starts
    a process for each (docs/train.md).
    """

    agent: RenetRunnerCfg
    """Networks and learning."""
    env: RenetEnvCfg
    """The task: mjlab's configuration of scene, rewards, curriculum and so on."""

    tyro_flags: ClassVar = mjlab.TYRO_FLAGS

    def __post_init__(self) -> None:
        if self.num_envs is not None:
            self.env.scene.num_envs = self.num_envs
        if self.scene is not None:
            ground = GroundFile(file=self.scene, width=self.scene_width, height=self.scene_height)
            add_own_ground(self.env.scene.terrain, ground.tile(), self.scene_share)

    @classmethod
    def from_task(cls, task: str, **options: Any) -> Self:
        """Return the settings that a task was registered with.

        Raises:
            RenetError: The task is unknown, or its agent is not renet's.
        """
        env = env_cfg(task)
        agent = load_rl_cfg(task)
        if not isinstance(agent, RenetRunnerCfg):
            raise RenetError(f"{task} is not trained by renet: its agent is of another class")
        return cls(task=task, env=env, agent=agent, **options)

    @classmethod
    def defaults(cls, arguments: Sequence[str]) -> Self:
        """Return the settings that a command line changes: a task's, a file's, or a resumed run's.

        Args:
            arguments: The command line, which need not name a task.

        Raises:
            RenetError: The task or an option is unknown, or file or run cannot be read.
        """
        parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
        parser.add_argument("--resume", nargs="?", const="")
        parser.add_argument("--log-root", "--log_root", nargs="?", type=Path)
        parser.add_argument("--config", nargs="?", type=Path)
        paths, _ = parser.parse_known_args(arguments)
        task = UsualOptions.task_of(arguments)
        if paths.resume is not None:
            path = checkpoints.find(resumed_folder(paths.resume, paths.log_root, task))
            return cls.resumed(checkpoints.load_state(path), task)
        if paths.config is not None:
            return cls.from_file(paths.config, task)
        if task:
            return cls.from_task(task)
        # Without a task the help shows the settings of the default one.
        return replace(cls.from_task(TASK), task=tyro.MISSING)

    @classmethod
    def from_file(cls, path: Path, task: str = "") -> Self:
        """Return the settings of a task, with those that a file changes.

        Args:
            path: Configuration file, JSON or YAML.
            task: Id of the task, by default the one that the file states.

        Raises:
            RenetError: The file cannot be read, or has a setting that the task lacks.
        """
        settings = read_settings(path)
        options = options_of(settings, path)
        robots = options.pop("num_envs", None)
        cfg = cls.from_task(task_of(settings, path, task), **options)
        for part in PARTS:
            if part in settings:
                changed = configured(getattr(cfg, part), settings[part], part)
                setattr(cfg, part, changed)
        # Not as an option of `train`, which would win over `--env.scene.num-envs`.
        if robots is not None:
            cfg.env.scene.num_envs = robots
        # A file that a run of another task wrote names that task, and its folder.
        names = {"task": cfg.task}
        if cfg.agent.experiment_name == cfg.agent.task:
            names["experiment_name"] = cfg.task
        cfg.agent = replace(cfg.agent, **names)
        return cfg

    @classmethod
    def resumed(cls, state: dict[str, Any], task: str = "") -> Self:
        """Return the settings of a checkpoint; those that it lacks are the task's.

        Args:
            state: The checkpoint's `state.json`.
            task: Id of the task, by default the checkpoint's. Of another task's checkpoint, only
                the agent and the number of robots are restored.

        Raises:
            RenetError: The task is not registered here, or a setting cannot be restored.
        """
        if not task:
            stored_env_cfg(state["task"])
        cfg = cls.from_task(task or state["task"])
        stored = state["env"]
        if cfg.task != state["task"]:
            stored = {"scene": {"num_envs": stored.get("scene", {}).get("num_envs")}}
        agent = restore(cfg.agent, state["agent"], "agent")
        agent = replace(agent, task=cfg.task, experiment_name=cfg.agent.experiment_name)
        return replace(cfg, env=restore(cfg.env, stored, "env"), agent=agent)


def train_command(cfg: TrainCfg) -> Path | None:
    """Train as the command `renet train`, whose time budget counts from the command's start.

    Raises:
        RenetError: As `train`; or the settings are of another task.
    """
    # What follows a setting such as `--agent.seed 3` is a value of it, for all that is known then.
    if cfg.agent.task != cfg.task:
        raise RenetError(
            f"write the task first: renet train {cfg.task} …; the settings are those of "
            f"{cfg.agent.task}"
        )
    return train(cfg, STARTED)


def train(cfg: TrainCfg, started: float | None = None) -> Path | None:
    """Train, and return the run's folder (None on ranks above 0).

    Under torchrun, or any launcher that sets RANK, LOCAL_RANK and WORLD_SIZE, each process trains
    its own robots, and gradients are averaged. The first Ctrl-C or TERM, or a terminal that closes,
    stops training with a checkpoint; a second signal interrupts it at once.

    Args:
        cfg: Settings of the training.
        started: Time of the monotonic clock from which the time budget counts, s; by default now.

    Raises:
        RenetError: The settings or the machine do not allow the training.
        SystemExit: A signal stopped it.
    """
    started = time.monotonic() if started is None else started
    deadline = started + seconds(cfg.time_budget)
    rank = int(os.getenv("RANK", "0"))
    device = resolve_device(cfg.device)
    # Before mjlab is used, because it wraps Warp's streams of the current device.
    if device != "cpu":
        torch.cuda.set_device(device)
    path, state = checkpoint_of(cfg)
    runner: RenetRunner | None = None
    stop_signals: list[int] = []

    def stop(number: int) -> None:
        # Before there is a runner, there is nothing to save.
        if runner is None:
            raise KeyboardInterrupt
        runner.stop.set()
        stop_signals.append(number)
        console.print("Stopping with a checkpoint; Ctrl-C again interrupts at once")

    with ExitStack() as stack:
        console = stack.enter_context(quiet(rank))
        stack.enter_context(signals(stop))
        # Rank 0 alone writes. A checkpoint of another task begins a new run.
        run = None
        if not rank and state.get("task") == cfg.task:
            run = resumed_run(path, cfg.log_root)
        if run:
            stack.enter_context(lock(run))
        env = make_vec_env(cfg, device, rank)
        stack.callback(env.close)
        # Only now, so that a task that cannot be built leaves no empty folder.
        if not run and not rank:
            run = new_run(cfg.log_root, cfg.agent.experiment_name, cfg.agent.run_name)
            stack.enter_context(lock(run))
        new_runner = make_runner(cfg, env, run, device)
        if path:
            new_runner.load(str(path))
            console.print(f"Going on from {path} ({new_runner.alg.steps / 1e6:.2f} M steps)")
        record_settings(cfg, new_runner, state, run, console)
        # From now on a signal stops with a checkpoint.
        runner = new_runner
        newest = learn(cfg, runner, run, console, deadline, stop_signals)
        if run is None:
            return None
        tell_end(cfg, runner, run, started, console)
        if stop_signals:
            console.print(f"Stopped at {newest}: renet train {cfg.task} --resume {run} goes on")
            # The exit code by which shells report a signal.
            raise SystemExit(128 + stop_signals[0])
    return run


def tell_end(
    cfg: TrainCfg, runner: RenetRunner, run: Path, started: float, console: Console
) -> None:
    """Say why a run ended before its last iteration, if by its budget, and draw its curves."""
    if runner.late:
        console.print(
            f"Ended after {time.monotonic() - started:.0f} s of the time budget of "
            f"{cfg.time_budget}: a further iteration, of up to {runner.longest:.0f} s, might not "
            f"fit; --resume {run} goes on"
        )
    if (run / CURVES).exists():
        console.print(f"Curves: {write_run_report(run)}")


def make_runner(
    cfg: TrainCfg, env: RslRlVecEnvWrapper, run: Path | None, device: str
) -> RenetRunner:
    """Build the runner that the task was registered with; without `run` it writes no files."""
    runner_cls = cast(type[RenetRunner], load_runner_cls(cfg.task))
    return runner_cls(env, asdict(cfg.agent), str(run) if run else None, device)


def record_settings(
    cfg: TrainCfg, runner: RenetRunner, state: dict[str, Any], run: Path | None, console: Console
) -> None:
    """Print how the settings differ from a checkpoint's, and write them to the run's folder.

    Args:
        cfg: Settings of the training.
        runner: Runner of the training.
        state: State of the checkpoint from which it continues; empty for a new run.
        run: Folder of the run; None on ranks above 0, which write nothing.
        console: Console to print on.
    """
    settings = runner.provenance()
    for part in ("agent", "env", "code"):
        for line in differences(state.get(part, settings[part]), settings[part], part):
            console.print(printable(line))
    if run is None:
        return
    robots = runner.env.num_envs
    console.print(f"Training {cfg.task} with {robots} robots in {run}")
    console.print(describe_iterations(cfg.agent, robots, runner.alg.steps))
    write_atomically(run / CONFIG_FILE, (json.dumps(settings, indent=1) + "\n").encode())


def learn(
    cfg: TrainCfg,
    runner: RenetRunner,
    run: Path | None,
    console: Console,
    deadline: float,
    stop_signals: Sequence[int],
) -> Path | None:
    """Run the remaining iterations, with reports and films, and return the last checkpoint.

    Args:
        cfg: Settings of the training.
        runner: Runner of the training.
        run: Folder of the run; None on ranks above 0.
        console: Console to report on.
        deadline: Time of the monotonic clock at which to end at the latest, s.
        stop_signals: Signals received so far; after one, the end does not wait for a film.
    """
    films = make_films(cfg, run, console)
    with (
        filming(films, deadline, stop_signals) as film,
        Report(console, runner, cfg.agent.max_iterations, deadline) as report,
    ):

        def after_iteration() -> None:
            report.update()
            film()

        return runner.learn(
            cfg.agent.max_iterations - runner.alg.iteration,
            time_budget_s=deadline - time.monotonic(),
            report=after_iteration,
        )


def make_films(cfg: TrainCfg, run: Path | None, console: Console) -> Films | None:
    """Build the films of a run; None if none are asked for, or on ranks above 0."""
    if not cfg.film_every or run is None:
        return None
    terrain = cfg.env.scene.terrain
    tiles = terrain is not None and terrain.terrain_generator is not None
    return Films(run, cfg.film_every, tiles, console.print)


def describe_iterations(agent: RenetRunnerCfg, robots: int, steps: int) -> str:
    """Say in words how many control steps an iteration has, now and later in the run.

    Args:
        agent: Settings of learning.
        robots: Robots of this process.
        steps: Environment steps that the run has taken.
    """
    fixed = agent.num_steps_per_env
    now = steps_per_env(fixed, agent.batch_size, robots, steps)
    later = steps_per_env(fixed, agent.batch_size, robots, math.inf)
    line = f"Each robot takes {now:,} control steps in an iteration"
    if later != now:
        line += f", later {later:,}"
    # The batch would need more steps than an iteration may have.
    if fixed is None and later == MOST_STEPS:
        line += ", the most there are: take more robots for larger batches"
    return line


def checkpoint_of(cfg: TrainCfg) -> tuple[Path | None, dict[str, Any]]:
    """Find the checkpoint from which to continue, and read its state.

    Returns:
        Folder and state; None and an empty state for a new run.

    Raises:
        RenetError: There is no checkpoint, or its run has finished all iterations.
    """
    if cfg.agent.resume:
        raise RenetError("--agent.resume is of mjlab's own train: write --resume RUN, or latest")
    if cfg.resume is None:
        return None, {}
    # By the same task as the settings in `TrainCfg.defaults`.
    path = checkpoints.find(resumed_folder(cfg.resume, cfg.log_root, cfg.task))
    state = checkpoints.load_state(path)
    if state["iteration"] >= cfg.agent.max_iterations:
        raise RenetError(
            f"{path} is at iteration {state['iteration']}: --max-iterations counts from "
            "the very first one and must be above that"
        )
    return path, state


def make_vec_env(cfg: TrainCfg, device: str, rank: int = 0) -> RslRlVecEnvWrapper:
    """Build the task's environments for rsl_rl; each rank has a seed of its own."""
    robots = cfg.env.scene.num_envs
    seed = cfg.agent.seed + rank
    # mjlab warns of its own randomisation.
    with warnings.catch_warnings(action="ignore"):
        env = make_env(cfg.env, robots, device, seed, cfg.engine)
    return RslRlVecEnvWrapper(env, clip_actions=cfg.agent.clip_actions)


@contextmanager
def quiet(rank: int = 0) -> Iterator[Console]:
    """Context with a console on standard output, which hides all that mjlab and rsl_rl print.

    On ranks above 0 the console prints nothing either. Where standard output cannot be written,
    training goes on.
    """
    shown = sys.stdout
    with open(os.devnull, "w") as nowhere, redirect_stdout(nowhere):
        file = cast(TextIO, LastingOutput(nowhere if rank else shown))
        yield Console(file=file, markup=False, highlight=False, soft_wrap=True)


def resolve_device(name: str) -> str:
    """Return this process's device for an option such as auto, cpu, cuda or cuda:1.

    Raises:
        RenetError: There is no such device.
    """
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


def show_recipe(cfg: RecipeCfg) -> None:
    """Print task, both configurations and the code's version as JSON.

    Raises:
        RenetError: There is no such checkpoint or task.
    """
    if cfg.checkpoint is not None:
        settings = checkpoints.load_state(checkpoints.find(cfg.checkpoint))
    else:
        run = TrainCfg.from_task(cfg.task)
        configurations = to_json({"agent": run.agent, "env": run.env})
        settings = {"task": cfg.task, **configurations, "code": code_version()}
    print(json.dumps(settings, indent=1))
