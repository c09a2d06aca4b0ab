"""Mean of a run's last weights, which is exported."""

from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel


class WeightAverage(AveragedModel):
    """Exponential moving average of a model's parameters and buffers.

    Each gradient step adds noise to the weights. Their mean along a run has less of it (Izmailov et
    al. 2018, arXiv 1803.05407) and often walks better than any single set of weights.
    """

    def __init__(self, model: nn.Module, over: int) -> None:
        """Initialize the average with the present weights.

        Args:
            model: The model, on the device where it learns.
            over: Number of updates that the average spans; 1 keeps the newest weights alone.
        """
        super().__init__(model, avg_fn=self._average, use_buffers=True)
        self.over = over

    def _average(self, average: Tensor, newest: Tensor, updates: Tensor | int) -> Tensor:
        """Average one tensor; integers, such as a normalizer's count, are copied."""
        if not newest.is_floating_point():
            return newest
        # At most the last quarter of the run: early weights say nothing about later ones.
        quarter = (int(updates) + 1) / 4
        span = max(1.0, min(self.over, quarter))
        return average.lerp(newest, 1.0 / span)

    def load(self, tensors: dict[str, Tensor], updates: int) -> None:
        """Load an average that was saved after a number of updates."""
        self.module.load_state_dict(tensors)
        self.n_averaged.fill_(updates)
