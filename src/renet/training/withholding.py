"""Images withheld from VP in training, which teaches it to walk on from memory."""

import torch
from torch import Tensor

from renet.interface import CONTROL_DT, STEPS_PER_TICK
from renet.tasks.schedule import value_at
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

    def tick(self, fresh: Tensor, easier: Tensor | None = None, steps: int = 0) -> Tensor:
        """Let a tick pass; [N] bool, false where the image is withheld.

        `fresh`, [N] bool, is true where an episode began since the last tick. `easier`, [N, 1], is
        not zero on tiles easier than the robot's level. `steps` environment steps are done.
        """
        if not self.cfg.share:
            return torch.ones_like(fresh)
        sees = self._robots & ~fresh & (self._left <= 0.0)
        self._left = (self._left - TICK).clamp_min(0.0) * ~fresh
        draw, length = torch.rand(2, len(fresh), device=fresh.device)
        easy = torch.zeros_like(fresh) if easier is None else easier.reshape(-1) != 0
        cfg, low = self.cfg, torch.full_like(length, self.cfg.shortest)
        low = low.masked_fill(easy, value_at(cfg.easier_shortest, steps))
        sight = torch.full_like(draw, cfg.sight)
        sight = sight.masked_fill(easy, value_at(cfg.easier_sight, steps))
        begins = sees & (draw < TICK / sight)
        # Log-uniform between the shortest and the longest.
        self._left = torch.where(begins, low * (cfg.longest / low) ** length, self._left)
        return self._left <= 0.0
