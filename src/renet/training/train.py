"""`renet train`: one process, or one per GPU."""

from __future__ import annotations

import json
import os
import re
import time
from dataclasses import asdict, dataclass, field, replace
from datetime import datetime
from itertools import chain, count
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
import tyro
from mjlab.rl import RslRlVecEnvWrapper

from renet.errors import RenetError
from renet.training import checkpoint as checkpoints
from renet.training.checkpoint import Checkpoint
from renet.training.config import LearningCfg, steps_per_env
from renet.training.metrics import CURVES
from renet.training.run_report import write_run_report
from renet.training.runner import CHECKPOINTS, RenetRunner

if TYPE_CHECKING:
    from renet.tasks import RenetEnvCfg

LATEST = "latest"
CONFIG = "config.json"


@dataclass(kw_only=True)
class TrainCfg(LearningCfg):
    """Train RENet. On a CPU the native engine steps C MuJoCo; on a GPU MuJoCo Warp.

    One GPU: `renet train TASK --num-envs 4096`. Four: add `--processes 4`; each trains its own
    4096. Two machines of four, reached by ssh: add `--hosts first second`. docs/training.md says
    how to use torchrun or Slurm instead.
    """

    task: tyro.conf.Positional[str]
    """Task id: Renet-Go1-Flat, Renet-Go1-Parkour, or one registered by a plug-in."""
    num_envs: int = 256
    """Parallel environments of each process (the paper trains with 4096 on a GPU)."""
    device: str = "auto"
    """cpu, cuda:0, ... or auto (a GPU if there is one)."""
    processes: int = 1
    """Training processes per host, one per GPU; gradients and statistics are shared."""
    hosts: tuple[str, ...] = ("localhost",)
    """Machines to train on, with renet installed in the same place on each."""
    engine: str = "auto"
    """Physics engine: auto, native (C MuJoCo on threads, CPU only) or warp."""
    reward_weights: dict[str, float] = field(default_factory=dict)
    """Weights in place of the task's, e.g. `--reward-weights collision -1 foot_clearance -15`; the
    others stay. docs/training.md says which ones help a small budget."""
    tile_shares: dict[str, float] = field(default_factory=dict)
    """Shares of the robots in place of the task's, e.g. `--tile-shares rough 1 stairs_up 2`; the
    others stay (rough 2, else 1)."""
    standing_after: int = 4000
    """Iterations after which goals ask for standing still, too: the second of the paper's two
    levels of commands. Reach it well before the end, or the robot never learns to stand."""
    resume: str | None = None
    """Run folder or checkpoint to go on from; `latest` takes the newest run of this task."""
    time_budget: str | None = None
    """Stop cleanly, with a checkpoint, before this much time has passed (90s, 25m, 8h), but not
    before one iteration is done."""
    log_root: Path = Path("logs")
    """Folder that receives a folder per run."""


def train(cfg: TrainCfg) -> Path | None:
    """Train and return the run folder (None on ranks above 0).

    Under torchrun (or any launcher that sets RANK, LOCAL_RANK and WORLD_SIZE) each process trains
    its own `num_envs` environments and gradients are averaged.

    Raises:
        RenetError: anything a user can put right.
    """
    from renet.tasks import make_env
    from renet.tasks.robot import ACTION_CLIP

    began = time.monotonic()
    if cfg.num_envs < 1:
        raise RenetError(f"--num-envs must be at least 1, got {cfg.num_envs}")
    rank = int(os.getenv("RANK", "0"))
    budget = None if cfg.time_budget is None else seconds(cfg.time_budget)
    device = resolve_device(cfg.device)
    resume = None if cfg.resume is None else resolve_resume(cfg.resume, cfg.log_root, cfg.task)
    earlier = None if resume is None else checkpoints.load(resume)
    # Another task's run stays as it is.
    own = resume if earlier is not None and earlier.state["task"] == cfg.task else None
    going_on = resumed_run(own)
    here = (Path("logs").resolve(), *(going_on.resolve().parents if going_on else ()))
    if going_on and cfg.log_root.resolve() not in here:
        raise RenetError(
            f"--resume goes on in {going_on}, which is not in --log-root {cfg.log_root}: leave out "
            "--log-root, or copy the run there and resume the copy"
        )
    task = tuned(cfg.task, cfg.reward_weights, cfg.tile_shares)
    task.curriculum["command_stage"].params["switch_step"] = _switch_step(cfg, earlier)
    env = make_env(
        task,
        num_envs=cfg.num_envs,
        device=device,
        seed=cfg.seed + rank,
        engine=cfg.engine,
    )
    vec_env = RslRlVecEnvWrapper(env, clip_actions=ACTION_CLIP)
    run = None if rank else going_on or new_run(cfg.log_root, cfg.task)
    runner = RenetRunner(vec_env, asdict(cfg), str(run) if run else None, device)
    if resume:
        runner.load(str(resume))
    if runner.alg.iteration >= cfg.max_iterations:
        raise RenetError(
            f"{resume} is at iteration {runner.alg.iteration}: --max-iterations counts from the "
            "very first one and must be above that"
        )
    if run:
        print(f"{'Resuming' if resume else 'Training'} {cfg.task} in {run}")
        record_config(replace(cfg, num_steps_per_env=runner.cfg["num_steps_per_env"]), run)
    try:
        left = None if budget is None else budget - (time.monotonic() - began)
        runner.learn(cfg.max_iterations - runner.alg.iteration, time_budget_s=left)
    finally:
        vec_env.close()
    if run and (run / CURVES).exists():
        print(f"Curves: {write_run_report(run)}")
    return run


def tuned(task: str, weights: dict[str, float], shares: dict[str, float]) -> RenetEnvCfg:
    """The task with other weights of rewards and shares of tiles.

    Raises:
        RenetError: a reward or a tile the task does not have, or a share of nothing.
    """
    from renet.tasks import env_cfg

    cfg = env_cfg(task)
    terrain = cfg.scene.terrain
    generator = terrain.terrain_generator if terrain else None
    tiles = generator.sub_terrains if generator else {}
    for what, known, asked in (("reward", cfg.rewards, weights), ("tile", tiles, shares)):
        for name in asked:
            if name not in known:
                choice = f"choose of {', '.join(known)}" if known else "it is flat"
                raise RenetError(f"{task} has no {what} {name!r}: {choice}")
    for name, weight in weights.items():
        cfg.rewards[name].weight = weight
    for name, share in shares.items():
        if not share > 0:
            raise RenetError(f"the share of tile {name!r} must be above 0, got {share}")
        tiles[name].proportion = share
    return cfg


def _switch_step(cfg: TrainCfg, earlier: Checkpoint | None) -> int:
    """Control step of the environment at which iteration `standing_after` begins."""
    taken, iteration = 0, 0
    if earlier is not None:
        taken = int(earlier.environment.get("common_step_counter", 0))
        iteration = earlier.state["iteration"]
    steps = steps_per_env(cfg.num_steps_per_env, cfg.num_envs)
    return taken + (cfg.standing_after - iteration) * steps


def record_config(cfg: TrainCfg, run: Path) -> None:
    """Write `config.json`, and say in which settings a run that goes on differs from before."""
    file = run / CONFIG
    settings = json.loads(json.dumps(asdict(cfg), default=str))
    try:
        before = _flat(json.loads(file.read_text())) if file.exists() else _flat(settings)
        now = _flat(settings)
        for name in sorted(set(before) | set(now)):
            old, new = before.get(name, "default"), now.get(name, "default")
            if old != new and name not in ("resume", "time_budget"):
                print(f"{name} was {old}, now {new}")
        file.write_text(json.dumps(settings, indent=1) + "\n")
    except (OSError, ValueError) as error:
        raise RenetError(f"cannot use {file}: {error}") from error


def _flat(settings: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested settings by dotted names."""
    flat = {}
    for name, value in settings.items():
        inner = isinstance(value, dict)
        flat |= _flat(value, f"{prefix}{name}.") if inner else {f"{prefix}{name}": value}
    return flat


def resumed_run(checkpoint: Path | None) -> Path | None:
    """The run a checkpoint belongs to, which then goes on; None for one kept elsewhere."""
    if checkpoint is None or checkpoint.parent.name != CHECKPOINTS:
        return None
    return checkpoint.parent.parent


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
    try:
        device = torch.device(name)
    except RuntimeError as error:
        raise RenetError(f"unknown device {name!r}: use cpu, cuda or cuda:N") from error
    if device.type == "cuda" and (device.index or 0) >= torch.cuda.device_count():
        raise RenetError(
            f"device {name} is absent: {torch.cuda.device_count()} CUDA devices are visible; "
            "use --device cpu, or cuda:0 where each process sees a GPU of its own"
        )
    if device.type not in ("cpu", "cuda"):
        raise RenetError(f"device {name!r} is not supported: use cpu, cuda or cuda:N")
    return name


def new_run(root: Path, task: str) -> Path:
    """Create `root/task/date_time`; raises RenetError where nothing can be written."""
    stamp = datetime.now().strftime("%Y-%m-%d_%H-%M-%S")
    # A second number for runs begun in the same second.
    names = chain([stamp], (f"{stamp}_{n}" for n in count(2)))
    try:
        run = next(path for name in names if not (path := root / task / name).exists())
        run.mkdir(parents=True)
    except OSError as error:
        raise RenetError(f"cannot write to {root}: {error}. Choose another --log-root") from error
    return run


def resolve_resume(resume: str, root: Path, task: str) -> Path:
    """The checkpoint folder that `--resume` names."""
    folder = root / task if resume == LATEST else Path(resume)
    if not folder.exists():
        raise RenetError(f"nothing to resume: {folder} does not exist")
    return checkpoints.find(folder)
