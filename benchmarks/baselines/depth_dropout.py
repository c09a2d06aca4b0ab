"""Depth images that fail during training, so that one policy learns to do without them.

The obvious alternative to a second estimator and a selector: show the network broken images until
it distrusts them by itself (random masking and noise of depth, as in Miki et al. 2022 for height
samples). Everything else of training stays.
"""

from dataclasses import dataclass, field
from typing import Any

import torch
from rsl_rl.env import VecEnv
from tensordict import TensorDict
from torch import Tensor

from renet.errors import RenetError
from renet.interface import CONTROL_DT
from renet.registry import register_task
from renet.tasks.parkour_env_cfg import parkour_env_cfg
from renet.training.config import RenetRunnerCfg, from_dict
from renet.training.recipe import recipe
from renet.training.runner import RenetRunner

TASK = "Renet-Go1-Parkour-Dropout"
KINDS = 3
"""Blank image, missing rectangle, strong noise."""
NOISE_STD = 0.5
"""Standard deviation of strong noise, image range 1."""


@dataclass
class DepthDropoutCfg:
    """Failures of the camera in training; off by default."""

    share: float = 0.0
    """Share of the time in which a robot's camera fails."""
    seconds: float = 2.0
    """Mean length of a failure."""

    def __post_init__(self) -> None:
        if not 0 <= self.share < 1 or self.seconds <= 0:
            raise RenetError(
                f"depth dropout: share {self.share} must be in [0, 1) and seconds {self.seconds}"
                " above 0"
            )


class DepthDropout:
    """A two-state process for each robot, and the images it spoils."""

    def __init__(self, cfg: DepthDropoutCfg, num_envs: int, dt: float, device: Any) -> None:
        """Set up with healthy cameras.

        Args:
            cfg: how much fails. num_envs: N. dt: seconds between calls. device: of the images.
        """
        self._ends = min(dt / cfg.seconds, 1.0)
        self._begins = self._ends * cfg.share / (1.0 - cfg.share)
        if self._begins > 1.0:
            raise RenetError(f"depth dropout: failures of {cfg.seconds} s are too short")
        self.kind = torch.zeros(num_envs, dtype=torch.long, device=device)
        """[N] 0: healthy; else 1 to KINDS."""
        self._box = torch.zeros(num_envs, 4, device=device)

    def __call__(self, depth: Tensor) -> Tensor:
        """Advance every camera by one step and spoil images [N, H, W]; draws from torch's RNG."""
        count, height, width = depth.shape
        draw, device = torch.rand(count, device=depth.device), depth.device
        failing = self.kind > 0
        begins = ~failing & (draw < self._begins)
        new = torch.randint(1, KINDS + 1, (count,), device=device)
        self.kind = torch.where(begins, new, self.kind * (~failing | (draw >= self._ends)))
        # Top, left, bottom and right: two numbers in order along each axis.
        boxes = torch.rand(count, 2, 2, device=device).sort(dim=1).values.flatten(1)
        self._box = torch.where(begins[:, None], boxes, self._box)
        rows = torch.arange(height, device=device)[None, :, None] / height
        columns = torch.arange(width, device=device)[None, None, :] / width
        blank, hidden, noisy = (self.kind == kind for kind in range(1, KINDS + 1))
        top, left, bottom, right = (side[:, None, None] for side in self._box[hidden].unbind(-1))
        inside = (rows >= top) & (rows <= bottom) & (columns >= left) & (columns <= right)
        spoilt = depth.masked_fill(blank[:, None, None], 0.0)
        spoilt[hidden] = depth[hidden].masked_fill(inside, 0.0)
        noise = NOISE_STD * torch.randn_like(depth[noisy])
        spoilt[noisy] = (depth[noisy] + noise).clamp(0.0, 1.0)
        return spoilt


def spoil_depth(env: Any, cfg: DepthDropoutCfg, dt: float) -> None:
    """Let the cameras of a vectorised environment fail from its first step on, in place.

    Args:
        env: what rsl_rl steps; its observations have a `depth`. cfg: how much fails.
        dt: seconds between steps.
    """
    dropout, step = DepthDropout(cfg, env.num_envs, dt, env.device), env.step

    def spoilt(actions: Tensor) -> tuple[TensorDict, Tensor, Tensor, dict]:
        observation, reward, done, extras = step(actions)
        observation["depth"] = dropout(observation["depth"])
        return observation, reward, done, extras

    env.step = spoilt


@dataclass(kw_only=True)
class DropoutRunnerCfg(RenetRunnerCfg):
    """The agent's configuration where cameras fail in training."""

    depth_dropout: DepthDropoutCfg = field(default_factory=DepthDropoutCfg)
    """How often they fail, and for how long."""


class DropoutRunner(RenetRunner):
    """RENet's runner, in an environment with these cameras."""

    def __init__(self, env: VecEnv, train_cfg: dict[str, Any], *args: Any) -> None:
        cfg = from_dict(DepthDropoutCfg, train_cfg["depth_dropout"])
        if cfg.share:
            spoil_depth(env, cfg, CONTROL_DT)
        super().__init__(env, train_cfg, *args)


def register_dropout() -> None:
    """Register the task in which cameras fail."""
    env, agent = parkour_env_cfg(), DropoutRunnerCfg()
    recipe(env, agent)
    register_task(TASK, env, parkour_env_cfg(play=True), agent, DropoutRunner)


register_dropout()
