"""Can anything a robot knows tell glass from healthy walking? Candidates for a monitor, measured.

Glass leaves each image believable: only what the legs meet gives it away. The same robots walk over
obstacles that they see and over obstacles of glass, and with healthy cameras over every kind of
tile, for that is where a threshold must hold. Reported for each candidate: the area under the curve
of its highest score in a walk, and how many walks on glass exceed every healthy one.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro
from scipy.stats import mannwhitneyu

from facts import report
from renet.bundle.policy import Policy
from renet.evaluation.env import SimEnv, terrain_env_cfg
from renet.evaluation.evaluator import Evaluator
from renet.evaluation.rollout import Trial
from renet.faults import Injection
from renet.interface import (
    DEPTH_RANGE,
    DEPTH_SHAPE,
    HEIGHT_MAP_X,
    HEIGHT_MAP_Y,
    STEPS_PER_TICK,
    proprioception_slices,
)
from renet.tasks.config.go1 import GO1
from renet.tasks.sensors import FEET_CONTACT
from renet.terrain.tiles import tiles

LINK, HIP, SIDE = 0.213, (0.1881, 0.04675), 0.08
"""The Go1's thigh and calf, its hips beside the base's middle, thighs beside the hips, m."""
LEFT, FRONT = np.array([-1, 1, -1, 1]), np.array([1, 1, -1, -1])
"""Signs of the legs in interface.LEGS."""
HEAVY = 18.0
"""N on a foot, reckoned from the joints' torques, above which it stands."""
BLOCK = (6, 8)
"""Pixels averaged against the camera's noise."""
HALF_SECOND, SEEN_FOR, WARM_UP = 25, 25, 10
"""Control steps of a mean, ticks for which relief counts as seen, ticks that do not count."""


@dataclass(frozen=True)
class Cfg:
    bundle: Path | None = None
    robots: int = 30
    """On seen obstacles, and as many on glass."""
    level: int = 3
    """Of the obstacles, 1 to 10."""
    healthy_robots: int = 60
    """Over all kinds of tiles at levels 1 to 6."""
    healthy_seconds: float = 20.0
    seed: int = 12
    json: Path | None = None


class Recorder(Policy):
    """VP in charge; writes down what the candidates need."""

    def __init__(self, evaluator: Evaluator, world: SimEnv) -> None:
        super().__init__(evaluator.bundle, world.num_robots)
        self._touch, self.log = world.env.scene[FEET_CONTACT], {}

    def step(self, proprioception, depth, op_mask):
        tick = self.due
        action = super().step(proprioception, depth, op_mask)
        seen = {
            "proprioception": proprioception,
            "contact": (self._touch.data.found > 0).numpy(),
            "velocity_op": self.velocity_op,
            "velocity_vp": self.velocity_vp,
        }
        if tick:
            seen |= {"image": depth.astype(np.float16), "map": self.height_map}
        for name, value in seen.items():
            self.log.setdefault(name, []).append(value.copy())
        return action


def walk(cfg: Cfg, evaluator: Evaluator, glass: bool) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Record a walk over obstacles, the second half of the robots on glass, or over all tiles."""
    if glass:
        numbers, steps = [*range(cfg.robots)] * 2, 400
        task = terrain_env_cfg("obstacles", cfg.level, evaluator.robot)
        faults = [()] * cfg.robots + [(Injection.of("glass", 5, 0),)] * cfg.robots
    else:
        numbers, steps = [*range(cfg.healthy_robots)], round(cfg.healthy_seconds * 50)
        task, faults = "parkour", [()] * cfg.healthy_robots
    world = evaluator.make_env(task, numbers, 0.6, cfg.seed)
    if not glass:
        robot = np.arange(cfg.healthy_robots)
        world.place(robot // len(tiles()) % 6, robot % len(tiles()))
    recorder = Recorder(evaluator, world)
    rows = [Trial("vp", fault, n) for fault, n in zip(faults, numbers, strict=True)]
    title = "glass" if glass else "all tiles"
    trace = evaluator.rollout(title, world, rows, steps, cfg.seed, policy=recorder)
    return {name: np.stack(values) for name, values in recorder.log.items()}, trace.fallen


def legs(proprioception: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Feet [T, N, 4, 3] in the base frame, force on them [T, N, 4] N, and "up" [T, N, 3]."""
    at, shape = proprioception_slices(), (*proprioception.shape[:2], 4, 3)
    default = np.array([[0.1 * -sign, 0.9, -1.8] for sign in LEFT])
    offset = proprioception[..., at["joint_position"]].reshape(shape)
    speed = proprioception[..., at["joint_velocity"]].reshape(shape) / 0.05
    target = GO1.action_scale * proprioception[..., at["last_action"]].reshape(shape)
    torque = GO1.stiffness * (target - offset) - GO1.damping * speed
    hip, thigh, calf = np.moveaxis(offset + default, -1, 0)
    x = -LINK * (np.sin(thigh) + np.sin(thigh + calf))
    z, y = -LINK * (np.cos(thigh) + np.cos(thigh + calf)), SIDE * LEFT
    feet = np.stack(
        (
            x + FRONT * HIP[0],
            y * np.cos(hip) - z * np.sin(hip) + LEFT * HIP[1],
            y * np.sin(hip) + z * np.cos(hip),
        ),
        -1,
    )
    # Statics of the leg's plane: torque = -J^T force.
    far, cross = -LINK * np.cos(thigh + calf), LINK * np.sin(thigh + calf)
    force = (far * torque[..., 1] - z * torque[..., 2]) / (z * cross + x * far)
    gravity = proprioception[..., at["projected_gravity"]]
    return feet, force, -gravity / np.linalg.norm(gravity, axis=-1, keepdims=True)


def step_height(feet: np.ndarray, up: np.ndarray, stands: np.ndarray) -> np.ndarray:
    """[ticks, N] m between the highest and lowest foot that stand at one snapshot of each tick."""
    stands = stands & np.concatenate([stands[:1], stands[:-1]])
    height = np.where(stands, (feet * up[:, :, None]).sum(-1), np.nan)
    with warnings.catch_warnings(action="ignore"):
        spread = np.nan_to_num(np.nanmax(height, -1) - np.nanmin(height, -1))
    return spread.reshape(-1, STEPS_PER_TICK, spread.shape[1]).max(1)


def seen_relief(image: np.ndarray, up: np.ndarray) -> np.ndarray:
    """[ticks, N] m by which the ground within 1.6 m leaves its best plane, in the last 2.5 s."""
    ticks, robots = image.shape[:2]
    blocks = (ticks, robots, DEPTH_SHAPE[0] // BLOCK[0], BLOCK[0], DEPTH_SHAPE[1] // BLOCK[1], -1)
    metres = image.astype(np.float32).reshape(blocks) * DEPTH_RANGE
    depth, far = metres.mean((3, 5)), (metres > 0.95 * DEPTH_RANGE).mean((3, 5))
    rows, columns = (np.arange(n) + 0.5 for n in depth.shape[2:])
    focal = 0.5 * DEPTH_SHAPE[1] / np.tan(np.radians(33.0))
    down, right = np.meshgrid(
        (rows * BLOCK[0] - DEPTH_SHAPE[0] / 2) / focal,
        (columns * BLOCK[1] - DEPTH_SHAPE[1] / 2) / focal,
        indexing="ij",
    )
    sine, cosine = np.sin(GO1.camera.pitch), np.cos(GO1.camera.pitch)
    rays = np.stack((cosine - sine * down, -right, -sine - cosine * down), -1)
    points = depth[..., None] * rays
    height = (points * up[:, :, None, None]).sum(-1).reshape(ticks, robots, -1)
    near = ((far < 0.02) & (depth < 1.6)).reshape(height.shape)
    plane = np.concatenate((points[..., :2], np.ones_like(points[..., :1])), -1)
    plane = plane.reshape(*height.shape, 3) * near[..., None]
    normal = np.einsum("tnpi,tnpj->tnij", plane, plane) + 1e-6 * np.eye(3)
    slope = np.linalg.solve(normal, np.einsum("tnpi,tnp->tni", plane, height * near)[..., None])
    rest = np.where(near, height - (plane @ slope)[..., 0], np.nan)
    with warnings.catch_warnings(action="ignore"):
        relief = np.nanquantile(rest, 0.95, axis=2) - np.nanquantile(rest, 0.05, axis=2)
    relief = np.nan_to_num(relief)
    return np.stack([relief[max(0, t + 1 - SEEN_FOR) : t + 1].max(0) for t in range(ticks)])


def smooth(values: np.ndarray) -> np.ndarray:
    """Means [ticks, ...] of the half second before each tick of [T, ...]."""
    ends = range(0, len(values), STEPS_PER_TICK)
    return np.stack([values[max(0, end + 1 - HALF_SECOND) : end + 1].mean(0) for end in ends])


def candidates(log: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Scores [ticks, N] by name; larger is more suspicious."""
    feet, force, up = legs(log["proprioception"])
    at_ticks = up[::STEPS_PER_TICK]
    relief = seen_relief(log["image"], at_ticks)
    ground = log["map"].reshape(*log["map"].shape[:2], len(HEIGHT_MAP_X), len(HEIGHT_MAP_Y))
    ahead = ground[:, :, 2:8, 3:8]
    free = np.ptp(ahead, axis=(2, 3)) < 0.04
    disagreement = smooth(log["velocity_op"] - log["velocity_vp"])
    slowness = 0.6 - smooth(log["velocity_op"])[..., 0]
    return {
        "velocities disagree": np.linalg.norm(disagreement, axis=-1),
        "slow, path free on VP's map": np.where(free, slowness, -1.0),
        "steps beyond seen, touch known": step_height(feet, up, log["contact"]) - 1.5 * relief,
        "steps beyond seen, from torque": step_height(feet, up, force > HEAVY) - 1.5 * relief,
    }


def highest(scores: np.ndarray, fallen: np.ndarray) -> np.ndarray:
    """Each robot's highest score [N] until its first fall, the first second aside."""
    upright = ~fallen[::STEPS_PER_TICK]
    return np.where(upright, scores, -np.inf)[WARM_UP:].max(0)


def main(cfg: Cfg) -> None:
    evaluator, found = Evaluator(cfg.bundle), {}
    (log, fallen), (calm, calm_fallen) = walk(cfg, evaluator, True), walk(cfg, evaluator, False)
    everywhere, succeeded = candidates(calm), ~calm_fallen[-1]
    for name, scores in candidates(log).items():
        walks = highest(scores, fallen)
        seen, glass = walks[: cfg.robots], walks[cfg.robots :]
        others = highest(everywhere[name], calm_fallen)[succeeded]
        area = mannwhitneyu(glass, seen).statistic / (len(glass) * len(seen))
        found[f"{name}: area"] = float(area)
        found[f"{name}: beyond obstacles"] = f"{(glass > seen.max()).sum()} of {cfg.robots}"
        found[f"{name}: beyond all tiles"] = f"{(glass > others.max()).sum()} of {cfg.robots}"
    found["healthy hours"] = float((~calm_fallen[:, succeeded]).sum() * 0.02 / 3600)
    falls = fallen[-1].reshape(2, -1)
    found["falls, obstacles seen"], found["falls, glass"] = (int(n) for n in falls.sum(1))
    report(found | {"bundle": evaluator.bundle.sha256[:10]}, cfg.json)


if __name__ == "__main__":
    main(tyro.cli(Cfg))
