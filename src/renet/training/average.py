"""The mean of a run's last weights, which is exported."""

from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel


class WeightAverage(AveragedModel):
    """Exponential moving average of a model's parameters and buffers, which is exported.

    Each gradient step leaves noise of its own in the weights. Their mean along a run has less of it
    (Izmailov et al. 2018, arXiv 1803.05407) and often walks better than any it is made of.
    """

    def __init__(self, model: nn.Module, over: int) -> None:
        """Start with the weights of a model that is where it is to stay.

        The average reaches back about `over` updates; 1 keeps the newest weights alone.
        """
        super().__init__(model, avg_fn=self._average, use_buffers=True)
        self.over = over

    def _average(self, average: Tensor, newest: Tensor, updates: Tensor | int) -> Tensor:
        """Counts such as a normaliser's are taken over."""
        if not newest.is_floating_point():
            return newest
        # Reaches back a quarter of the run at most: early weights say nothing about later ones.
        return average.lerp(newest, 1.0 / max(1.0, min(self.over, (int(updates) + 1) / 4)))

    def load(self, tensors: dict[str, Tensor], updates: int) -> None:
        """Go on with an average that was saved after so many updates."""
        self.module.load_state_dict(tensors)
        self.n_averaged.fill_(updates)
