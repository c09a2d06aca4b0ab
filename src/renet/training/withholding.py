"""Withholding of images from VP in training, so that it learns to walk on from memory."""

import torch
from torch import Tensor

from renet.interface import TICK_DT
from renet.tasks.schedule import value_at
from renet.training.config import WithholdingCfg


class Withholding:
    """Random spans of time in which some robots get no images.

    The losses compare with the true map in these spans, too: from that VP learns to remember. Each
    episode begins with images, so that there is something to remember.
    """

    def __init__(self, cfg: WithholdingCfg, num_envs: int, device: str | torch.device) -> None:
        self.cfg = cfg
        # Robots that lose images, spread evenly, so that each kind of tile has its share.
        counts = torch.floor(torch.arange(num_envs + 1, device=device) * cfg.share)
        self._robots = counts.diff() > 0
        # Seconds until each robot gets images again.
        self._remaining = torch.zeros(num_envs, device=device)

    def tick(self, fresh: Tensor, easier: Tensor | None = None, steps: int = 0) -> Tensor:
        """Advance by one 10 Hz tick.

        Args:
            fresh: True where an episode began since the last tick, [N] bool.
            easier: Not zero where a robot is on a tile below its level, [N, 1].
            steps: Environment steps taken so far, for settings that follow a schedule.

        Returns:
            False where the image of this tick is withheld, [N] bool.
        """
        if not self.cfg.share:
            return torch.ones_like(fresh)
        can_begin = self._robots & ~fresh & (self._remaining <= 0.0)
        self._remaining = (self._remaining - TICK_DT).clamp_min(0.0) * ~fresh

        # Shortest span and mean time between spans, which may differ on easier tiles.
        chance, length = torch.rand(2, len(fresh), device=fresh.device)
        shortest = torch.full_like(length, self.cfg.shortest)
        sight = torch.full_like(chance, self.cfg.sight)
        easy = torch.zeros_like(fresh) if easier is None else easier.reshape(-1) != 0
        shortest = shortest.masked_fill(easy, value_at(self.cfg.easier_shortest, steps))
        sight = sight.masked_fill(easy, value_at(self.cfg.easier_sight, steps))

        # Begin new spans, with lengths log-uniform between the shortest and the longest.
        begins = can_begin & (chance < TICK_DT / sight)
        span = shortest * (self.cfg.longest / shortest) ** length
        self._remaining = torch.where(begins, span, self._remaining)
        return self._remaining <= 0.0
