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
import warp as wp
from mjlab.utils.lab_api.math import matrix_from_quat

from facts import report
from renet.sim.depth_camera import DepthCamera
from renet.sim.raycast import cast_depth
from renet.sim.threads import THREADS
from renet.tasks import make_env
from renet.vocabulary import STEPS_PER_TICK


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


def seconds(cfg: Cfg, work: Callable[[], object]) -> float:
    """Median time of one image of every camera."""
    times = []
    for _ in range(cfg.images):
        start = time.perf_counter()
        work()
        if cfg.device != "cpu":
            torch.cuda.synchronize()
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def cast_in_one_thread(camera: DepthCamera) -> torch.Tensor:
    """All rays in one launch, which Warp runs on one core of a CPU, without noise."""
    base = matrix_from_quat(camera._data.xquat[:, camera._body])
    eye = (
        camera._data.xpos[:, camera._body] + (base @ camera._position.unsqueeze(-1)).squeeze(-1)
    ).contiguous()
    axes, rays = (base @ camera._rotation).contiguous(), camera._rays
    depth = torch.empty(len(eye), len(rays), device=eye.device)
    arrays = (
        wp.from_torch(eye, dtype=wp.vec3),
        wp.from_torch(axes, dtype=wp.mat33),
        wp.from_torch(rays, dtype=wp.vec3),
    )
    scanner = camera._scanner
    inputs = [scanner.grid, *arrays, 0, camera.cfg.range, wp.from_torch(depth)]
    wp.launch(cast_depth, depth.shape, inputs, device=scanner.device)
    return depth


def main(cfg: Cfg) -> None:
    wp.config.quiet = True
    with redirect_stdout(StringIO()):
        env = make_env("Renet-Go1-Parkour", cfg.num_envs, cfg.device)
    env.reset()
    camera = env.scene["depth_camera"]
    camera._render()  # Compiles kernels.
    single_s = seconds(cfg, lambda: cast_in_one_thread(camera))
    image_s = seconds(cfg, camera._render)
    actions, steps = torch.zeros(cfg.num_envs, 12, device=cfg.device), 10 * STEPS_PER_TICK
    env.step(actions)
    start = time.perf_counter()
    for _ in range(steps):
        env.step(actions)
    step_s = (time.perf_counter() - start) / steps
    rays = cfg.num_envs * len(camera._rays)
    report(
        {
            "num_envs": cfg.num_envs,
            "device": cfg.device,
            "triangles": camera._scanner.triangles,
            "rays_per_s_per_core": rays / single_s,
            "threads": THREADS,
            "rays_per_s": rays / image_s,
            "seconds_per_image": image_s,
            "seconds_per_env_step": step_s,
            "share_of_env_step": image_s / STEPS_PER_TICK / step_s,
        },
        cfg.json,
    )


if __name__ == "__main__":
    main(tyro.cli(Cfg))
