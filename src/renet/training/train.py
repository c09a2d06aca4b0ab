"""`renet train`: one process, or one per GPU; and `renet recipe`, which says how."""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import re
import time
import warnings
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from datetime import datetime
from itertools import chain, count
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, cast

import torch
import tyro
from mjlab.managers.curriculum_manager import CurriculumTermCfg
from mjlab.rl import RslRlVecEnvWrapper

from renet.errors import RenetError
from renet.files import write_atomically
from renet.folders import new_folder
from renet.models.config import ModelCfg
from renet.tasks.parkour_env_cfg import RandomizationCfg
from renet.training import checkpoint as checkpoints
from renet.training.checkpoint import Checkpoint, described, say_differences
from renet.training.config import (
    AdaptationCfg,
    LearningCfg,
    NP3OCfg,
    Schedule,
    SupervisionCfg,
    WithholdingCfg,
    from_dict,
    schedule_points,
    value_at,
)
from renet.training.metrics import CURVES, write_run_report
from renet.training.recipe import RENET, preset
from renet.training.runner import CHECKPOINTS, RenetRunner
from renet.version import code_version

if TYPE_CHECKING:
    from renet.tasks import RenetEnvCfg

LATEST = "latest"
CONFIG = "config.json"
LOGS = Path("logs")
DEFAULT_ENVS = {"cpu": 512, "cuda": 4096}
Pairs = tuple[tuple[str, float], ...]
Schedules = tuple[tuple[str, Schedule], ...]
MERGED = ("reward_weights", "terrain_proportions")
"""Settings whose entries replace those of the preset one by one."""
NOT_KEPT = ("resume", "time_budget", "log_root")
"""Settings of the machine and the hour, which a checkpoint does not keep."""


@dataclass(kw_only=True)
class TrainCfg(LearningCfg):
    """Train RENet. On a CPU the native engine steps C MuJoCo; on a GPU MuJoCo Warp.

    Without options but size and time this is the default recipe (`training/recipe.py`). One GPU:
    `renet train TASK --num-envs 4096`. Several: torchrun or Slurm start a process for each, which
    trains its own 4096 (docs/training.md).
    """

    task: tyro.conf.Positional[str]
    """Task id: Renet-Go1-Flat, Renet-Go1-Parkour, or one registered by a plug-in."""
    preset: Literal["renet", "paper"] = "renet"
    """Where the defaults of all other settings come from: our recipe, or the paper's
    (for 1.5 billion steps)."""
    num_envs: int | None = None
    """Parallel environments of each process; by default 512 on a CPU and 4096 on a GPU (paper)."""
    device: str = "auto"
    """cpu, cuda:0, ... or auto (a GPU if there is one)."""
    engine: str = "auto"
    """Physics engine: auto, native (C MuJoCo on threads, CPU only) or warp."""
    # What LearningCfg documents, as the recipe sets it.
    model: ModelCfg = field(default_factory=lambda: preset()["model"])
    algorithm: NP3OCfg = field(default_factory=lambda: preset()["algorithm"])
    supervision: SupervisionCfg = field(default_factory=lambda: preset()["supervision"])
    adaptation: AdaptationCfg = field(default_factory=lambda: preset()["adaptation"])
    withholding: WithholdingCfg = field(default_factory=lambda: preset()["withholding"])
    batch_size: Schedule = RENET["batch_size"]
    reward_weights: Schedules = ()
    """Weights in place of the preset's, e.g. `--reward-weights collision -10 yaw 1@5M,2@9M`; the
    others stay."""
    terrain_proportions: Pairs = ()
    """Share of the robots on each kind of tile, relative to the others', in place of the preset's,
    e.g. `--terrain-proportions gap 3`; the others stay."""
    dense_tiles: bool = RENET["dense_tiles"]
    """Train on tiles with more edges: gaps two to three times as many (`terrain/tiles.py`)."""
    depth_noise_std: float = RENET["depth_noise_std"]
    """Standard deviation of the constant part of the depth error, m."""
    randomization: RandomizationCfg = field(default_factory=lambda: preset()["randomization"])
    """How the robots differ beyond the task's own randomisation."""
    standing_after: float = RENET["standing_after"]
    """Environment steps after which goals ask for standing still, too: the second of the paper's
    two levels of commands."""
    easier_after: float | None = RENET["easier_after"]
    """Environment steps after which a quarter of the episodes is on tiles of levels up to a robot's
    own instead of its own; None: never."""
    easier_kinds: tuple[str, ...] = RENET["easier_kinds"]
    """Kinds of tile on which it is so."""
    resume: str | None = None
    """Run folder or checkpoint to go on from, with its settings; `latest` takes the newest run of
    this task."""
    time_budget: str | None = None
    """Stop cleanly, with a checkpoint, before this much time has passed (90s, 25m, 8h), but not
    before one iteration is done."""
    log_root: Path | None = None
    """Folder that receives a folder per run; by default `logs`, or where the run to go on from is.
    Another one than that run's branches off: the run itself stays as it is."""

    runner: ClassVar[type[RenetRunner]] = RenetRunner

    @classmethod
    def defaults(cls, arguments: Sequence[str]) -> TrainCfg:
        """What a command line of `renet train` starts from: its `--preset`, or the run it resumes.

        Raises:
            RenetError: unknown preset, or nothing to resume.
        """
        parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
        parser.add_argument("--preset", nargs="?", const="", default="renet")
        parser.add_argument("--resume", nargs="?", const="")
        parser.add_argument("--log-root", "--log_root", nargs="?", type=Path)
        asked, _ = parser.parse_known_args(arguments)
        task = next((a for a in arguments[:1] if not a.startswith("-")), tyro.MISSING)
        if asked.resume is not None:
            if asked.resume == LATEST and task is tyro.MISSING:
                raise RenetError("write the task first: renet train TASK --resume latest")
            found = resolve_resume(asked.resume, asked.log_root, task)
            return restored(checkpoints.load_state(found), task, cls)
        own = {key: value for key, value in preset(asked.preset).items() if key not in MERGED}
        return cls(task=task, preset=asked.preset, **own)

    def make_env(self, task: RenetEnvCfg, device: str, seed: int) -> Any:
        """The task's environments as rsl_rl takes them."""
        from renet.tasks import make_env
        from renet.tasks.robot_cfg import ACTION_CLIP

        # mjlab prints tables of terms and warns of its own randomisation.
        with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings(action="ignore"):
            env = make_env(task, cast(int, self.num_envs), device, seed, self.engine)
        return RslRlVecEnvWrapper(env, clip_actions=ACTION_CLIP)


def restored(
    state: dict[str, Any], task: Any = tyro.MISSING, cls: type[TrainCfg] = TrainCfg
) -> TrainCfg:
    """The settings in a checkpoint's state, defaults for what it lacks, and the task if given."""
    own = {f.name for f in fields(cls)} - {"task", *NOT_KEPT}
    settings = {name: value for name, value in state["config"].items() if name in own}
    # Before it was a setting, no image was withheld.
    settings = {"withholding": asdict(WithholdingCfg())} | settings
    task = state["task"] if task is tyro.MISSING else task
    return from_dict(cls, settings | {"task": task})


def train(cfg: TrainCfg) -> Path | None:
    """Train and return the run folder (None on ranks above 0).

    Under torchrun (or any launcher that sets RANK, LOCAL_RANK and WORLD_SIZE) each process trains
    its own `num_envs` environments and gradients are averaged.

    Raises:
        RenetError: anything a user can put right.
    """
    began = time.monotonic()
    rank = int(os.getenv("RANK", "0"))
    budget = None if cfg.time_budget is None else seconds(cfg.time_budget)
    device = resolve_device(cfg.device)
    if device != "cpu":  # Before mjlab wraps Warp's streams: as those of the current device.
        torch.cuda.set_device(device)
    num_envs = DEFAULT_ENVS[device.partition(":")[0]] if cfg.num_envs is None else cfg.num_envs
    cfg = replace(cfg, num_envs=num_envs)
    resume = None if cfg.resume is None else resolve_resume(cfg.resume, cfg.log_root, cfg.task)
    earlier = None if resume is None else checkpoints.load(resume)
    if earlier is not None and earlier.state["iteration"] >= cfg.max_iterations:
        raise RenetError(
            f"{resume} is at iteration {earlier.state['iteration']}: --max-iterations counts from "
            "the very first one and must be above that"
        )
    task = task_cfg(cfg, earlier)
    vec_env = cfg.make_env(task, device, cfg.seed + rank)
    # Another task's run stays as it is.
    own = resume if earlier is not None and earlier.state["task"] == cfg.task else None
    run = None if rank else resumed_run(own, cfg.log_root) or new_run(cfg.log_root, cfg.task)
    runner = cfg.runner(vec_env, settings(cfg), str(run) if run else None, device)
    if resume:
        runner.load(str(resume))
    if run:
        if earlier is not None:
            print(f"Going on from {resume} ({runner.alg.steps / 1e6:.2f} M steps)")
            for part, value in runner.provenance().items():
                say_differences(earlier.state.get(part, value), value, part)
        print(f"Training {cfg.task} with {num_envs} robots in {run}")
        write_atomically(run / CONFIG, (json.dumps(settings(cfg), indent=1) + "\n").encode())
    try:
        left = None if budget is None else budget - (time.monotonic() - began)
        runner.learn(cfg.max_iterations - runner.alg.iteration, time_budget_s=left)
    finally:
        vec_env.close()
    if run and (run / CURVES).exists():
        print(f"Curves: {write_run_report(run)}")
    return run


def settings(cfg: TrainCfg) -> dict[str, Any]:
    """The configuration as the runner takes it and a checkpoint keeps it: plain JSON."""
    kept = {name: value for name, value in asdict(cfg).items() if name not in NOT_KEPT}
    return json.loads(json.dumps(kept, default=str))


def task_cfg(cfg: TrainCfg, earlier: Checkpoint | None = None) -> RenetEnvCfg:
    """The task as the recipe sets it, for a run that goes on from the checkpoint `earlier`.

    Raises:
        RenetError: a reward or a tile the task does not have, or a share of nothing.
    """
    from renet.tasks import env_cfg, mdp
    from renet.tasks.parkour_env_cfg import randomize
    from renet.tasks.sensors import depth_camera
    from renet.terrain.tiles import dense_tiles

    task = env_cfg(cfg.task)
    weights, shares = (preset(cfg.preset)[name] | dict(getattr(cfg, name)) for name in MERGED)
    for name, weight in weights.items():
        if name not in task.rewards:
            known = ", ".join(task.rewards)
            raise RenetError(f"{cfg.task} has no reward {name!r}: choose one of {known}")
        task.rewards[name].weight = value_at(weight, 0.0)
        points = [(_control_step(at, cfg, earlier), v) for at, v in schedule_points(weight)]
        if len(points) > 1:
            params = {"reward": name, "points": points}
            term = CurriculumTermCfg(func=mdp.reward_weight, params=params)
            task.curriculum[f"{name}_weight"] = term
    depth_camera(task).noise.gaussian_std = cfg.depth_noise_std
    randomize(task, cfg.randomization)
    if "command_stage" in task.curriculum:
        switch_step = _control_step(cfg.standing_after, cfg, earlier)
        task.curriculum["command_stage"].params["switch_step"] = switch_step
    if "level" in task.curriculum and cfg.easier_after is not None:
        easier_step = _control_step(cfg.easier_after, cfg, earlier)
        params = {"easier_step": easier_step, "easier_kinds": cfg.easier_kinds}
        task.curriculum["level"].params |= params
    generator = task.scene.terrain.terrain_generator if task.scene.terrain else None
    if generator is None:
        return task
    if cfg.dense_tiles:
        generator.sub_terrains = cast(Any, dense_tiles())
        task.scene.terrain.max_init_terrain_level = 0  # It is flat.
    for name, share in shares.items():
        if name not in generator.sub_terrains:
            known = ", ".join(generator.sub_terrains)
            raise RenetError(f"{cfg.task} has no tile {name!r}: choose one of {known}")
        if not share > 0:
            raise RenetError(f"the share of tile {name!r} must be above 0, got {share}")
        generator.sub_terrains[name].proportion = share
    return task


def _control_step(env_steps: float, cfg: TrainCfg, earlier: Checkpoint | None) -> float:
    """The environment's control step at which so many environment steps are done."""
    taken = steps = 0
    if earlier is not None:
        taken = int(earlier.environment.get("common_step_counter", 0))
        steps = earlier.state["steps"]
    robots = (cfg.num_envs or 1) * int(os.getenv("WORLD_SIZE", "1"))
    return taken + (env_steps - steps) / robots


def resumed_run(checkpoint: Path | None, root: Path | None) -> Path | None:
    """The run that goes on; None where a new one begins.

    Args:
        checkpoint: to go on from; one that is not its run's newest, or in no run's folder, begins a
            run of its own.
        root: `--log-root`; another one than the run's branches off.
    """
    if checkpoint is None or checkpoint.parent.name != CHECKPOINTS:
        return None
    run = checkpoint.parent.parent
    elsewhere = root is not None and run.resolve().parent.parent != root.resolve()
    newest = checkpoints.checkpoints(checkpoint.parent)[-1]
    return None if elsewhere or newest != checkpoint else run


def seconds(text: str) -> float:
    """Parse a duration such as 90s, 25m or 1.5h; a bare number is seconds."""
    match = re.fullmatch(r"(\d+(?:\.\d+)?)([smh]?)", text.strip())
    if not match:
        raise RenetError(f"time budget {text!r} is not a duration: write 90s, 25m or 8h")
    return float(match[1]) * {"": 1, "s": 1, "m": 60, "h": 3600}[match[2]]


def resolve_device(name: str) -> str:
    """Turn `auto` and `cuda` into this process's device and refuse one that is absent."""
    if name == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    if name == "cuda":
        name = f"cuda:{os.getenv('LOCAL_RANK', '0')}"
    if not re.fullmatch(r"cpu|cuda:\d+", name):
        raise RenetError(f"unknown device {name!r}: use cpu, cuda or cuda:N")
    if name != "cpu" and int(name.removeprefix("cuda:")) >= torch.cuda.device_count():
        raise RenetError(
            f"device {name} is absent: {torch.cuda.device_count()} CUDA devices are visible; "
            "start fewer processes, use --device cpu, or cuda:0 where each process sees its own GPU"
        )
    return name


def new_run(root: Path | None, task: str) -> Path:
    """Create `root/task/date_time`, by default in `logs`; raises RenetError where it cannot."""
    root = root or LOGS
    stamp = datetime.now().strftime("%Y-%m-%d_%H-%M-%S")
    # A second number for runs begun in the same second.
    for name in chain([stamp], (f"{stamp}_{n}" for n in count(2))):
        try:
            return new_folder(root / task / name)
        except FileExistsError as error:
            if not (root / task).is_dir():
                reason = f"{root / task} is no folder: choose another --log-root"
                raise RenetError(reason) from error
        except OSError as error:
            reason = f"cannot write to {root}: {error}. Choose another --log-root"
            raise RenetError(reason) from error
    raise AssertionError


def resolve_resume(resume: str, root: Path | None, task: str) -> Path:
    """The checkpoint folder that `--resume` names."""
    folder = (root or LOGS) / str(task) if resume == LATEST else Path(resume)
    if not folder.exists():
        raise RenetError(f"nothing to resume: {folder} does not exist")
    return checkpoints.find(folder)


@dataclass(kw_only=True)
class RecipeCfg:
    """Print how a checkpoint was trained, or how `renet train` would begin now, as JSON."""

    checkpoint: tyro.conf.Positional[Path | None] = None
    """Checkpoint, or a run folder whose newest checkpoint is taken; by default, the recipe of a run
    that would begin now."""
    task: str = "Renet-Go1-Parkour"
    """Task of the run that would begin now."""
    preset: Literal["renet", "paper"] = "renet"
    """Preset of the run that would begin now."""


def show(cfg: RecipeCfg) -> None:
    """Print settings, the task's rules and the code's version; raises RenetError without any."""
    if cfg.checkpoint is not None:
        recipe = checkpoints.load_state(checkpoints.find(cfg.checkpoint))
    else:
        run = TrainCfg.defaults([cfg.task, "--preset", cfg.preset])
        run = replace(run, num_envs=DEFAULT_ENVS[resolve_device("auto").partition(":")[0]])
        task = described(task_cfg(run))
        recipe = {"config": settings(run), "task_cfg": task, "code": code_version()}
    print(json.dumps(recipe, indent=1))
