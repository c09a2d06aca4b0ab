"""Depth rays per second on the parkour terrain, and the share of a training step they cost."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

import torch
import tyro

from facts import errors_in_one_line, report
from renet.interface import STEPS_PER_TICK
from renet.sim.depth.raycast import TerrainScanner
from renet.sim.threads import THREADS
from renet.tasks import make_env


@dataclass
class Cfg:
    """Measure depth."""

    num_envs: int = 256
    """Cameras."""
    images: int = 10
    """Images of every camera."""
    device: str = "cpu"
    """cpu or cuda:N."""
    json: Path | None = None
    """Result file."""


def seconds(
    cfg: Cfg, work: Callable[[], object], clock: Callable[[], float] = time.perf_counter
) -> float:
    """Median time of one image of every camera; with `time.process_time` summed over threads."""
    times = []
    for _ in range(cfg.images):
        start = clock()
        work()
        if cfg.device != "cpu":
            torch.cuda.synchronize()
        times.append(clock() - start)
    return statistics.median(times)


def main(cfg: Cfg) -> None:
    with redirect_stdout(StringIO()):
        env = make_env("Renet-Go1-Parkour", cfg.num_envs, cfg.device)
    env.reset()
    camera = env.scene["depth_camera"]
    camera._render()  # Compiles kernels.
    scanner, poses, limit = camera._scanner, camera._view(), camera.cfg.range
    lens = camera.cfg.intrinsics
    caster = TerrainScanner(env.sim.mj_model, cfg.device)
    caster.depth(*poses, lens, limit)
    clock = time.process_time if cfg.device == "cpu" else time.perf_counter
    drawn_s = seconds(cfg, lambda: scanner.depth(*poses, lens, limit), clock)
    cast_s = seconds(cfg, lambda: caster.depth(*poses, lens, limit), clock)
    image_s = seconds(cfg, camera._render)
    actions, steps = torch.zeros(cfg.num_envs, 12, device=cfg.device), 10 * STEPS_PER_TICK
    env.step(actions)
    start = time.perf_counter()
    for _ in range(steps):
        env.step(actions)
    step_s = (time.perf_counter() - start) / steps
    count = cfg.num_envs * lens.height * lens.width
    report(
        {
            "num_envs": cfg.num_envs,
            "device": cfg.device,
            "triangles": len(scanner.triangles),
            "rays_per_s_per_core": count / drawn_s,
            "rays_cast_per_s_per_core": count / cast_s,
            "threads": THREADS,
            "rays_per_s": count / image_s,
            "seconds_per_image": image_s,
            "seconds_per_env_step": step_s,
            "share_of_env_step": image_s / STEPS_PER_TICK / step_s,
        },
        cfg.json,
    )


if __name__ == "__main__":
    with errors_in_one_line():
        main(tyro.cli(Cfg))
