"""Supervised losses: Loss_OP (RENet eq. 1), Loss_VP (eq. 2) and Loss_ad (eq. 4)."""

import math
from collections.abc import Callable
from functools import partial

import numpy as np
import torch
from torch import Tensor, nn

from renet.faults import Frames
from renet.faults.vegetation import TallGrass
from renet.interface import DEPTH_SHAPE, FRAMES
from renet.models.him import target_view
from renet.models.renet import RENet
from renet.training import distributed
from renet.training.config import SupervisionCfg, value_at
from renet.training.precision import computed_in, side_by_side
from renet.training.storage import TickRollout

AUTOENCODER_SHARE = 0.4
"""Largest share of a mini-batch's image pairs: with few robots, whose pairs are much alike, the
autoencoder would else learn from each and take longer than both estimators."""
GRASS_SHARE = 0.15
"""Share of the detector's image pairs with grass; with twice as many it notices less else."""
GRASS_BLADES = 20
"""Most blades in view: `tall_grass` at severity 2 of 5."""
GRASS_VIEWS = 512
"""Different views of blades."""


class Supervision:
    """Trains both estimators, their HIM and the autoencoder; owns their optimiser."""

    def __init__(
        self, model: RENet, cfg: SupervisionCfg, dtype: torch.dtype = torch.float32
    ) -> None:
        """Set up for a model that is where it is to stay; its depth embedding learns in `dtype`."""
        self.model, self.cfg, self.dtype = model, cfg, dtype
        self.parameters = model.supervised_parameters()
        # Apart: likelihoods must not shorten the estimators' steps.
        likelihoods = (model.autoencoder, model.vp.map_error_head)
        # In order, as no set of tensors is: a norm's last bit depends on it.
        self._apart = dict.fromkeys(p for m in likelihoods if m for p in m.parameters())
        if model.cfg.detector == "variance":
            self._grass = draw_grass().to(self.parameters[0].device)
        rate = value_at(cfg.learning_rate, 0.0)
        self.optimizer = torch.optim.Adam(self.parameters, lr=rate, fused=True)

    def update(self, rollout: TickRollout, steps: float = 0.0) -> dict[str, Tensor]:
        """Learn from one rollout's ticks, before which `steps` environment steps were taken.

        Returns:
            Mean losses by name, and of each HIM the prototypes' effective rank and usage.
        """
        self.optimizer.param_groups[0]["lr"] = value_at(self.cfg.learning_rate, steps)
        environments = rollout.op_mask.shape[1]
        totals: dict[str, list[Tensor]] = {}
        with computed_in(self.dtype, self.model.vp.depth):
            for _ in range(self.cfg.num_learning_epochs):
                order = torch.randperm(environments, device=rollout.op_mask.device)
                for index in order.chunk(self.cfg.num_mini_batches):
                    for name, loss in self._step(rollout.environments(index)).items():
                        totals.setdefault(name, []).append(loss)
        losses = {name: torch.stack(values).mean() for name, values in totals.items()}
        for name in ("op", "vp"):
            him = getattr(self.model, f"{name}_him")
            if f"{name}_him" in losses:
                losses |= {f"{name}_him_rank": him.effective_rank(), f"{name}_him_usage": him.usage}
        return losses

    def _step(self, rollout: TickRollout) -> dict[str, Tensor]:
        """One gradient step; returns the losses."""
        self.optimizer.zero_grad()
        rest, vp = side_by_side(
            partial(self._gradient, self._blind_losses, rollout),
            partial(self._gradient, self._vp_losses, rollout),
        )
        distributed.average_gradients(self.parameters)
        estimators = [p for p in self.parameters if p not in self._apart]
        for parameters in (estimators, self._apart):
            nn.utils.clip_grad_norm_(parameters, self.cfg.max_grad_norm)
        self.optimizer.step()
        return rest | vp

    def _gradient(
        self, terms: Callable[[TickRollout], dict[str, Tensor]], rollout: TickRollout
    ) -> dict[str, Tensor]:
        """Go back through the sum of some terms, scaled as `SupervisionCfg` says; their values."""
        velocity, height = self.cfg.velocity_scale**2, self.cfg.height_scale**2
        weights = {"velocity": velocity, "feet_height": height, "height_map": height}
        weights["far_map"] = height
        losses = terms(rollout)
        if losses:
            scaled = [loss * weights.get(name[3:], 1.0) for name, loss in losses.items()]
            torch.stack(scaled).sum().backward()
        return {name: loss.detach() for name, loss in losses.items()}

    def _blind_losses(self, rollout: TickRollout) -> dict[str, Tensor]:
        """Terms that share no parameter with VP's."""
        images = rollout.frames[rollout.has_image]
        return self.estimator_losses("op", rollout) | self._anomaly_losses(images)

    def _vp_losses(self, rollout: TickRollout) -> dict[str, Tensor]:
        return self.estimator_losses("vp", rollout)

    def estimator_losses(self, name: str, rollout: TickRollout) -> dict[str, Tensor]:
        """Every term of the loss of the estimator `name`, op or vp, over the ticks that train it.

        Returns:
            Named scalars. Absent heads are absent, and nothing is returned where no tick trains the
            estimator: gradients of zero would let Adam's momentum move one that does not learn.
        """
        chosen = rollout.op_mask if name == "op" else ~rollout.op_mask
        if self.cfg.estimator_data == "all":
            chosen = torch.ones_like(chosen)
        mine = chosen.any(dim=0)
        learns = self.model.cfg.perception.replace("oracle", "vp")
        if learns not in ("renet", name) or not mine.any():
            return {}
        rollout, counts = rollout.environments(mine), chosen[:, mine].float()
        estimator, him = getattr(self.model, name), getattr(self.model, f"{name}_him")
        initial = getattr(rollout, f"latent_{name}")[0]
        images = rollout.frames.float(), rollout.has_image
        latent = estimator.unroll(rollout.history, *images, initial, rollout.fresh)

        def mean(loss: Tensor) -> Tensor:
            """Over ticks that train the estimator, of [K, B, ...]."""
            return (loss.mean(-1) * counts).sum() / counts.sum().clamp_min(1.0)

        losses, squares = {}, {}
        for head, predicted in estimator.predict(latent).items():
            squares[head] = (predicted - getattr(rollout, head)).square()
            losses[f"{name}_{head}"] = mean(squares[head])
        if name == "vp" and estimator.map_error_head is not None:
            log_variance = estimator.map_log_variance(latent)
            scaled = squares["height_map"].detach() / log_variance.exp()
            losses["vp_map_nll"] = mean(0.5 * (scaled + log_variance))
        if him is not None:
            paired = (counts * rollout.next_valid).flatten()
            following = target_view(rollout.next_proprioception, rollout.next_velocity)
            losses[f"{name}_him"] = him(latent.flatten(0, 1), following.flatten(0, 1), paired)
        return losses

    def _anomaly_losses(self, pairs: Tensor) -> dict[str, Tensor]:
        """The detector's losses on some of the image pairs [B, 2, 48, 64], randomly drawn."""
        if len(pairs) == 0:
            return {}
        count = min(self.cfg.autoencoder_images, math.ceil(AUTOENCODER_SHARE * pairs.shape[0]))
        pairs = pairs[torch.randperm(pairs.shape[0], device=pairs.device)[:count]].float()
        if self.model.cfg.detector == "variance":
            pairs = grow_grass(pairs, self._grass)
        return self.model.autoencoder.loss(pairs)


def draw_grass(seed: int = 0) -> Tensor:
    """Depth of blades alone, [512, 48, 64]: 1 where there are none, 0 where one is not measured."""
    rng = np.random.default_rng(seed)
    nothing = Frames.healthy(np.ones((1, *DEPTH_SHAPE), np.float32))
    counts = rng.integers(1, GRASS_BLADES + 1, GRASS_VIEWS)
    views = [TallGrass(count, [rng]).corrupt(nothing, np.zeros(1)).image[0] for count in counts]
    return torch.from_numpy(np.stack(views))


def grow_grass(pairs: Tensor, views: Tensor) -> Tensor:
    """Put blades before the first 15 % of image pairs [B, 2, 48, 64], other ones in each image."""
    count = round(GRASS_SHARE * len(pairs))
    drawn = torch.randint(len(views), (count, FRAMES), device=pairs.device)
    return torch.cat([torch.minimum(pairs[:count], views[drawn]), pairs[count:]])
