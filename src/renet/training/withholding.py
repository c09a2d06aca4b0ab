"""Images withheld from VP in training, which teaches it to walk on from memory."""

import math

import torch
from torch import Tensor

from renet.interface import CONTROL_DT, STEPS_PER_TICK
from renet.training.config import WithholdingCfg

TICK = STEPS_PER_TICK * CONTROL_DT
"""Seconds between two images."""


class Withholding:
    """Decides at each 10 Hz tick which robots get their image.

    Losses go on against the true map meanwhile: that is what VP learns to remember from. Episodes
    begin with sight, so that there is something to remember.
    """

    def __init__(self, cfg: WithholdingCfg, num_envs: int, device: str | torch.device) -> None:
        self.cfg = cfg
        # Evenly spread, so that each kind of tile has its share.
        counts = torch.floor(torch.arange(num_envs + 1, device=device) * cfg.share)
        self._robots = counts.diff() > 0
        self._left = torch.zeros(num_envs, device=device)

    def tick(self, fresh: Tensor) -> Tensor:
        """Let a tick pass; [N] bool, false where the image is withheld.

        `fresh`, [N] bool, is true where an episode began since the last tick.
        """
        if not self.cfg.share:
            return torch.ones_like(fresh)
        sees = self._robots & ~fresh & (self._left <= 0.0)
        self._left = (self._left - TICK).clamp_min(0.0) * ~fresh
        draw, length = torch.rand(2, len(fresh), device=fresh.device)
        low, high = math.log(self.cfg.shortest), math.log(self.cfg.longest)
        begins = sees & (draw < TICK / self.cfg.sight)
        self._left = torch.where(begins, torch.exp(low + length * (high - low)), self._left)
        return self._left <= 0.0
