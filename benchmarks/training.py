"""Where a training iteration goes, in env-steps per second, shares by part and peak memory.

The same run also trains mjlab's stock flat Go1 (no camera) with its own PPO on the same engine, and
takes depth images with mjlab's own ray-cast camera in the same scene.
"""

from __future__ import annotations

import resource
import time
from collections import defaultdict
from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import asdict, dataclass, replace
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import torch
import tyro
from mjlab.envs import ManagerBasedRlEnv
from mjlab.rl import MjlabOnPolicyRunner, RslRlVecEnvWrapper
from mjlab.sensor import ObjRef, PinholeCameraPatternCfg, RayCastSensorCfg
from mjlab.tasks.registry import load_env_cfg, load_rl_cfg
from rich.progress import track
from torch.utils._python_dispatch import TorchDispatchMode

from facts import errors_in_one_line, report
from renet.interface import ACTION_SIZE, DEPTH_RANGE, DEPTH_SHAPE, STEPS_PER_TICK, TRUNK
from renet.sim.native.engine import use_engine
from renet.tasks import RenetEnv, make_env
from renet.tasks.env import env_cfg
from renet.training import checkpoint as checkpoints
from renet.training.runner import RenetRunner
from renet.training.train import TrainCfg, make_vec_env, quiet

STOCK = "Mjlab-Velocity-Flat-Unitree-Go1"


@dataclass
class Cfg:
    """Profile training."""

    task: str = "Renet-Go1-Parkour"
    """Task."""
    num_envs: int = 256
    """Environments."""
    device: str = "cpu"
    """cpu or cuda:N."""
    engine: str = "auto"
    """auto, native or warp."""
    resume: Path | None = None
    """Checkpoint to go on from, with its settings, or a folder with one: robots that walk are reset
    less often than untrained ones."""
    iterations: int = 6
    """Iterations measured, after one that warms up."""
    stock: bool = True
    """Also train mjlab's stock Go1."""
    camera_envs: int = 16
    """Environments in which both depth cameras are timed, on a CPU mjlab's takes long; 0: none."""
    json: Path | None = None
    """Result file."""


class Stopwatch:
    """Accumulates the seconds spent inside wrapped methods."""

    def __init__(self, device: str) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self.device = device

    def wrap(self, owner: Any, method: str, part: str) -> None:
        original: Callable[..., Any] = getattr(owner, method)

        def timed(*args: Any, **kwargs: Any) -> Any:
            start = self.now()
            try:
                return original(*args, **kwargs)
            finally:
                self.seconds[part] += self.now() - start

        setattr(owner, method, timed)

    def now(self) -> float:
        if self.device.startswith("cuda"):
            torch.cuda.synchronize()
        return time.perf_counter()


class Operations(TorchDispatchMode):
    """Counts torch's operations, each a launch on a GPU and some microseconds on a CPU."""

    count = 0

    def __torch_dispatch__(self, function: Any, types: Any, args: Any = (), kwargs: Any = None):
        self.count += 1
        return function(*args, **(kwargs or {}))


def operations(env: RenetEnv) -> dict[str, float]:
    """Numbers of operations in a control step without a reset, and in a reset."""
    env.reset()
    with Operations() as steps:
        for _ in range(STEPS_PER_TICK):
            env.step(torch.zeros(env.num_envs, ACTION_SIZE, device=env.device))
    with Operations() as reset:
        env._reset_idx(torch.tensor([0], device=env.device))
    return {
        "operations_per_step": steps.count / STEPS_PER_TICK,
        "operations_per_reset": reset.count,
    }


def settings(cfg: Cfg) -> TrainCfg:
    """Settings of the training: the task's, or those of the checkpoint that it goes on from."""
    if cfg.resume is None:
        train_cfg = TrainCfg.from_task(cfg.task)
    else:
        train_cfg = TrainCfg.resumed(checkpoints.load_state(checkpoints.find(cfg.resume)), cfg.task)
    train_cfg.env.scene.num_envs = cfg.num_envs
    return replace(train_cfg, engine=cfg.engine)


def profile(cfg: Cfg, folder: str) -> dict[str, Any]:
    """Train, and return where the time goes.

    Returns:
        Among others `profile`, the parts' shares of an iteration, and `learning`, the shares in
        which policy and estimators learn: at the same time on a CPU, so that `update` is less than
        their sum.
    """
    train_cfg = settings(cfg)
    with redirect_stdout(StringIO()):
        vec_env = make_vec_env(train_cfg, cfg.device)
        runner = RenetRunner(vec_env, asdict(train_cfg.agent), folder, cfg.device)
    env: Any = vec_env.unwrapped
    runner.open_log()
    if cfg.resume:
        runner.load(str(cfg.resume))
    watch = Stopwatch(cfg.device)
    for owner, method, part in (
        (env.sim, "step", "physics"),
        (env.sim, "forward", "forward"),
        (env.scene["depth_camera"], "_render", "depth"),
        (env.scene["height_map"], "_compute_data", "terrain scans"),
        (env.scene["feet_height"], "_compute_data", "terrain scans"),
        (vec_env, "step", "environment"),
        (runner.alg, "act", "inference"),
        (runner.alg, "process_env_step", "storage"),
        (runner.logger, "process_env_step", "log"),
        (runner.logger, "log", "log"),
        (runner.alg, "compute_returns", "values"),
        (runner.alg, "_learn", "update"),
    ):
        watch.wrap(owner, method, part)
    learning = Stopwatch(cfg.device)
    learning.wrap(runner.alg.np3o, "update", "N-P3O")
    learning.wrap(runner.alg.supervision, "update", "supervision")
    runner.alg.model.train()
    with quiet() as console:
        obs = runner._iterate(vec_env.get_observations(), 0, cfg.iterations + 1)
        watch.seconds.clear()
        learning.seconds.clear()
        steps_before = runner.alg.steps
        start = watch.now()
        what = f"{cfg.task}, {cfg.num_envs} envs"
        for i in track(range(cfg.iterations), what, transient=True, console=console):
            obs = runner._iterate(obs, 0, cfg.iterations + 1 - i)
        total = watch.now() - start
    parts = dict(watch.seconds)
    inside = ("physics", "forward", "depth", "terrain scans")
    parts["managers"] = parts.pop("environment") - sum(parts[name] for name in inside)
    parts["rest"] = total - sum(parts.values())
    # Batches may grow from one iteration to the next.
    steps = runner.alg.steps - steps_before
    results = {
        "task": cfg.task,
        "num_envs": cfg.num_envs,
        "device": cfg.device,
        "learning_type": str(runner.alg.np3o.dtype).removeprefix("torch."),
        "env_steps_per_s": steps / total,
        "seconds_per_iteration": total / cfg.iterations,
        **operations(env),
        "profile": {name: value / total for name, value in sorted(parts.items())},
        "learning": {name: value / total for name, value in sorted(learning.seconds.items())},
    }
    vec_env.close()
    return results


def stock_steps_per_second(cfg: Cfg) -> float:
    env_cfg, agent = load_env_cfg(STOCK), load_rl_cfg(STOCK)
    env_cfg.scene.num_envs, env_cfg.seed = cfg.num_envs, 0
    with redirect_stdout(StringIO()), use_engine(cfg.engine, cfg.device):
        env = RslRlVecEnvWrapper(ManagerBasedRlEnv(env_cfg, cfg.device))
        runner = MjlabOnPolicyRunner(env, asdict(agent), None, cfg.device)
        runner.learn(1)
        start = time.perf_counter()
        runner.learn(cfg.iterations)
    if cfg.device.startswith("cuda"):
        torch.cuda.synchronize()
    steps = cfg.iterations * agent.num_steps_per_env * cfg.num_envs
    return steps / (time.perf_counter() - start)


def cameras_rays_per_second(cfg: Cfg) -> dict[str, float]:
    """RENet's camera and mjlab's, both 64 x 48 from the trunk over the same terrain."""
    task = env_cfg(cfg.task)
    height, width = DEPTH_SHAPE
    task.scene.sensors += (
        RayCastSensorCfg(
            name="mjlab_camera",
            frame=ObjRef(type="body", name=TRUNK, entity="robot"),
            pattern=PinholeCameraPatternCfg(width=width, height=height, fovy=52.0),
            max_distance=DEPTH_RANGE,
        ),
    )
    with redirect_stdout(StringIO()):
        env = make_env(task, cfg.camera_envs, cfg.device, engine=cfg.engine)
    env.reset()
    rays = cfg.camera_envs * height * width
    seconds = {
        "depth_rays_per_s": best_seconds(env.scene["depth_camera"]._render, cfg.device),
        "mjlab_camera_rays_per_s": best_seconds(env.sim.sense, cfg.device),
    }
    env.close()
    return {name: rays / value for name, value in seconds.items()}


def best_seconds(call: Callable[[], Any], device: str, repeats: int = 5) -> float:
    """The shortest time of a call, s, once it has compiled what it needs."""
    watch = Stopwatch(device)
    call()
    laps = []
    for _ in range(repeats):
        start = watch.now()
        call()
        laps.append(watch.now() - start)
    return min(laps)


def peak_memory(device: str) -> int:
    """Bytes of this process; on a GPU those of the whole device, as torch does not count Warp's."""
    if device.startswith("cuda"):
        free, total = torch.cuda.mem_get_info(torch.device(device))
        return total - free
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def main(cfg: Cfg) -> None:
    with TemporaryDirectory() as folder:  # Curves are written, as in training.
        results = profile(cfg, folder)
    results["peak_memory_bytes"] = peak_memory(cfg.device)
    for name, share in results["profile"].items():
        print(f"  {name:<22} {share:6.1%}")
    for name, share in results["learning"].items():
        print(f"  of the update, {name:<15} {share:6.1%}")
    if cfg.stock:
        results["stock_env_steps_per_s"] = stock_steps_per_second(cfg)
        results["ratio_to_stock"] = results["env_steps_per_s"] / results["stock_env_steps_per_s"]
    if cfg.camera_envs:
        results |= cameras_rays_per_second(cfg)
    report(results, cfg.json)


if __name__ == "__main__":
    with errors_in_one_line():
        main(tyro.cli(Cfg))
