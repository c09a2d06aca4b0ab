"""The mean of a run's last weights, which is what a checkpoint exports.

Each gradient step leaves noise of its own in the weights. Their mean along a run has less of it
(Izmailov et al. 2018, arXiv 1803.05407) and often walks better than any of those it is made of.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn


class WeightAverage:
    """Exponential moving average of a model's parameters and buffers."""

    def __init__(self, model: nn.Module, over: int) -> None:
        """Start with the model's weights.

        Args:
            model: network on the device where it is to stay.
            over: updates the average reaches back, about; 1 keeps the newest weights alone.
        """
        self.over, self.updates = over, 0
        self.tensors = {name: value.clone() for name, value in model.state_dict().items()}

    @torch.no_grad()
    def update(self, model: nn.Module) -> None:
        """Take in the model's present weights; counts such as a normaliser's are taken over."""
        self.updates += 1
        # Reaches back a quarter of the run at most: early weights say nothing about later ones.
        share = 1.0 / max(1.0, min(self.over, self.updates / 4))
        for name, value in model.state_dict().items():
            if value.is_floating_point():
                self.tensors[name].lerp_(value, share)
            else:
                self.tensors[name].copy_(value)

    def load(self, tensors: dict[str, Tensor], updates: int) -> None:
        """Go on with an average that was saved after so many updates."""
        self.updates = updates
        for name, value in tensors.items():
            self.tensors[name].copy_(value)
