"""Conditions of a study other than the ground: as in training, by default, or nominal.

Under nominal conditions bodies, starts and the camera's mount differ a little, and images have
noise; the other sensors are exact, images are never late, and robots are not pushed.
"""

from __future__ import annotations

import math
from copy import deepcopy
from dataclasses import dataclass, field, replace

import torch
from mjlab.managers.event_manager import EventTermCfg
from mjlab.utils.noise import UniformNoiseCfg
from torch import Tensor

from renet.errors import RenetError
from renet.interface import CONTROL_DT
from renet.tasks import RenetEnvCfg
from renet.tasks.sensors import depth_camera

PUSH = "push"
"""Name of the event that pushes robots, in a task's configuration."""
_PUSH_AXES = ("x", "y", "z", "roll", "pitch", "yaw")
"""Components of a push, in the order of a body's velocity."""


def use_training_conditions(cfg: RenetEnvCfg, trained: RenetEnvCfg) -> None:
    """Set a study's task to the bodies, motors, sensors and pushes of training, in place.

    Starts, the noise of images and whatever else a study varies are not changed.

    Args:
        cfg: The study's task, made with `play=True`.
        trained: The task in its training variant; raises RenetError if it delays joint targets,
            for twins cannot have the same delays.
    """
    if trained.motors.target_delay[1] > 0.0:
        raise RenetError(
            "this bundle's task delays joint targets in training, which a study cannot draw alike"
            " for twins: give --conditions nominal"
        )
    # Start-up events draw the bodies; the others, such as the spawn, are the study's own.
    for name, event in trained.events.items():
        if event.mode == "startup" or name == PUSH:
            cfg.events[name] = deepcopy(event)
    cfg.motors = deepcopy(trained.motors)
    camera = depth_camera(cfg)
    other = depth_camera(trained)
    camera.delay = other.delay
    camera.mount = replace(
        camera.mount,
        position_error=other.mount.position_error,
        angle_error=other.mount.angle_error,
    )
    cfg.observations["proprioception"] = deepcopy(trained.observations["proprioception"])


@dataclass
class Disturbances:
    """Sensor noise and pushes of R robots, drawn by robot number, so that twins have the same.

    mjlab draws both by row.
    """

    push: EventTermCfg | None = None
    """Times and velocities of pushes; None: robots are not pushed."""
    noise: UniformNoiseCfg | None = None
    """Noise of the proprioception before it is scaled; None: there is none."""
    scale: Tensor = field(default_factory=lambda: torch.ones(()))
    """Scales of the proprioception, [45]."""

    @classmethod
    def extract(cls, cfg: RenetEnvCfg) -> Disturbances:
        """Remove the disturbances from a configuration, in place, and return them."""
        disturbances = cls(push=cfg.events.pop(PUSH, None))
        # Left in place, mjlab's noise would differ between twins.
        group = cfg.observations["proprioception"]
        term = group.terms["value"]
        if group.enable_corruption and isinstance(term.noise, UniformNoiseCfg):
            disturbances.noise = term.noise
            term.noise = None
            disturbances.scale = torch.tensor(term.scale)
        return disturbances

    def restart(self, robots: int, seed: int) -> None:
        """Begin a run of R robots."""
        self._random = torch.Generator().manual_seed(seed)
        self._robots = robots
        self._until_push = self._draw_intervals()

    def draw_noise(self) -> Tensor | None:
        """Draw noise of the scaled proprioception, [R, 45]; None if there is none."""
        if self.noise is None:
            return None
        low = torch.tensor(self.noise.n_min)
        high = torch.tensor(self.noise.n_max)
        share = torch.rand((self._robots, *low.shape), generator=self._random)
        return (low + share * (high - low)) * self.scale

    def draw_pushes(self) -> tuple[Tensor, Tensor]:
        """Draw the robots to push in the next step, [R] bool, and changes of velocity, [R, 6]."""
        self._until_push = self._until_push - CONTROL_DT
        # Less than a rounding error is left of the time.
        pushed = self._until_push < 1e-6
        change = torch.zeros(self._robots, len(_PUSH_AXES))
        if self.push is not None and pushed.any():
            self._until_push = torch.where(pushed, self._draw_intervals(), self._until_push)
            ranges = self.push.params["velocity_range"]
            low, high = torch.tensor([ranges.get(axis, (0.0, 0.0)) for axis in _PUSH_AXES]).T
            change = low + torch.rand(change.shape, generator=self._random) * (high - low)
        return pushed, change

    def _draw_intervals(self) -> Tensor:
        """Draw the time until the next push, [R] s."""
        if self.push is None or self.push.interval_range_s is None:
            return torch.full((self._robots,), math.inf)
        low, high = self.push.interval_range_s
        return low + torch.rand(self._robots, generator=self._random) * (high - low)
