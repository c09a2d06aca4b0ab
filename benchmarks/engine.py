"""Steps per second of the native engine and of mjlab's Warp-CPU backend, in one run.

Whole environment steps of mjlab's stock Go1 tasks under random actions: physics, managers, sensors.
"""

from __future__ import annotations

import time
from contextlib import redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

import torch
import tyro
from mjlab.envs import ManagerBasedRlEnv
from mjlab.tasks.registry import load_env_cfg
from rich.progress import track

from facts import errors_in_one_line, report
from renet.sim.native.engine import use_engine

TASKS = {"": "Mjlab-Velocity-Flat-Unitree-Go1", "rough_": "Mjlab-Velocity-Rough-Unitree-Go1"}


@dataclass
class Cfg:
    """Compare engines."""

    num_envs: int = 256
    """Environments."""
    native_steps: int = 150
    """Control steps measured on the native engine."""
    warp_steps: int = 4
    """Control steps measured on Warp's CPU backend, which takes over a second for each."""
    json: Path | None = None
    """Result file."""


def steps_per_second(task: str, engine: str, num_envs: int, steps: int) -> float:
    cfg = load_env_cfg(task)
    cfg.scene.num_envs, cfg.seed = num_envs, 0
    with redirect_stdout(StringIO()), use_engine(engine, "cpu"):
        env = ManagerBasedRlEnv(cfg, "cpu")
    env.reset()
    actions = torch.Generator().manual_seed(0)
    env.step(torch.zeros(num_envs, 12))  # Compiles kernels.
    start = time.perf_counter()
    for _ in track(range(steps), f"{task} on {engine}", transient=True):
        env.step(0.3 * torch.randn(num_envs, 12, generator=actions))
    return num_envs * steps / (time.perf_counter() - start)


def main(cfg: Cfg) -> None:
    # Both engines alike: a second torch thread for small tensors costs more than it computes.
    torch.set_num_threads(1)
    results: dict[str, float] = {"num_envs": cfg.num_envs}
    for prefix, task in TASKS.items():
        native = steps_per_second(task, "native", cfg.num_envs, cfg.native_steps)
        warp = steps_per_second(task, "warp", cfg.num_envs, cfg.warp_steps)
        results |= {
            f"{prefix}native_steps_per_s": native,
            f"{prefix}warp_cpu_steps_per_s": warp,
            f"{prefix}ratio": native / warp,
        }
    report(results, cfg.json)


if __name__ == "__main__":
    with errors_in_one_line():
        main(tyro.cli(Cfg))
