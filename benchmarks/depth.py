"""Depth rays per second on the parkour terrain, and the share of a training step they cost."""

from __future__ import annotations

import time
from contextlib import redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

import torch
import tyro
import warp as wp

from facts import report
from renet.sim.threads import THREADS
from renet.tasks import make_env
from renet.vocabulary import STEPS_PER_TICK


@dataclass
class Cfg:
    """Measure depth."""

    num_envs: int = 256
    """Cameras."""
    images: int = 20
    """Images of every camera."""
    device: str = "cpu"
    """cpu or cuda:N."""
    json: Path | None = None
    """Result file."""


def main(cfg: Cfg) -> None:
    wp.config.quiet = True
    with redirect_stdout(StringIO()):
        env = make_env("Renet-Go1-Parkour", cfg.num_envs, cfg.device)
    env.reset()
    camera = env.scene["depth_camera"]
    camera._render()  # Compiles kernels.
    start = time.perf_counter()
    for _ in range(cfg.images):
        camera._render()
    if cfg.device != "cpu":
        torch.cuda.synchronize()
    image_s = (time.perf_counter() - start) / cfg.images
    actions, steps = torch.zeros(cfg.num_envs, 12, device=cfg.device), 10 * STEPS_PER_TICK
    env.step(actions)
    start = time.perf_counter()
    for _ in range(steps):
        env.step(actions)
    step_s = (time.perf_counter() - start) / steps
    rays = cfg.num_envs * len(camera._rays) / image_s
    cores = THREADS if cfg.device == "cpu" else 1
    report(
        {
            "num_envs": cfg.num_envs,
            "device": cfg.device,
            "triangles": len(camera._scanner.mesh.indices) // 3,
            "rays_per_s": rays,
            "cores": cores,
            "rays_per_s_per_core": rays / cores,
            "seconds_per_image": image_s,
            "seconds_per_env_step": step_s,
            "share_of_env_step": image_s / STEPS_PER_TICK / step_s,
        },
        cfg.json,
    )


if __name__ == "__main__":
    main(tyro.cli(Cfg))
