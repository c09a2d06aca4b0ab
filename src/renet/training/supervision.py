"""Supervised losses: Loss_OP (RENet eq. 1), Loss_VP (eq. 2) and Loss_ad (eq. 4)."""

import math
from collections.abc import Callable
from dataclasses import dataclass
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


PARTS = ("op", "vp", "detector")
"""What learns by supervision; each from some of the data, or not at all."""


@dataclass
class MiniBatch:
    """Some environments of a rollout, and what is to be learnt from them."""

    index: Tensor
    """The environments, [B]."""
    op: Tensor
    """Those with ticks that train OP, [<= B]."""
    vp: Tensor
    """Those with ticks that train VP, [<= B]."""
    images: int
    """Number of ticks with an image."""
    learning: list[str]
    """The `PARTS` that learn from this mini-batch on any rank."""


class Supervision:
    """Trains both estimators, their HIM and the autoencoder; owns their optimiser."""

    def __init__(
        self, model: RENet, cfg: SupervisionCfg, dtype: torch.dtype = torch.float32
    ) -> None:
        """Set up for a model that is where it is to stay; its depth embedding learns in `dtype`."""
        self.model, self.cfg, self.dtype = model, cfg, dtype
        self.parameters = model.supervised_parameters()
        modules = (model.op, model.op_him), (model.vp, model.vp_him), (model.autoencoder,)
        self._parts = {
            part: [p for module in of_part if module for p in module.parameters()]
            for part, of_part in zip(PARTS, modules, strict=True)
        }
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

        A GPU is waited for once in each epoch, and at the end.

        Returns:
            Mean losses by name, and of each HIM the prototypes' effective rank and usage.
        """
        self.optimizer.param_groups[0]["lr"] = value_at(self.cfg.learning_rate, steps)
        totals: dict[str, list[Tensor]] = {}
        with computed_in(self.dtype, self.model.vp.depth):
            for _ in range(self.cfg.num_learning_epochs):
                for batch in self.draw_mini_batches(rollout):
                    for name, loss in self._step(rollout, batch).items():
                        totals.setdefault(name, []).append(loss)
        losses = {name: torch.stack(values).mean() for name, values in totals.items()}
        for name in ("op", "vp"):
            him = getattr(self.model, f"{name}_him")
            if f"{name}_him" in losses:
                losses |= {f"{name}_him_rank": him.effective_rank(), f"{name}_him_usage": him.usage}
        return losses

    @torch.no_grad()
    def draw_mini_batches(self, rollout: TickRollout) -> list[MiniBatch]:
        """Share a rollout's environments out at random, for one epoch.

        The host must know the sizes of selections. It fetches all at once: to select by masks would
        wait for a GPU each time.
        """
        op = self._ticks_that_train("op", rollout).any(dim=0)
        vp = self._ticks_that_train("vp", rollout).any(dim=0)
        images = rollout.has_image.sum(dim=0)
        per_environment = torch.stack((op, vp, images)).double()  # As PARTS are ordered.
        order = torch.randperm(len(op), device=op.device)
        indices = order.chunk(self.cfg.num_mini_batches)
        here = torch.stack([per_environment[:, index].sum(dim=-1) for index in indices])
        on_any_rank = distributed.mean(here)
        sizes = torch.stack((here, on_any_rank), dim=1).tolist()
        return [
            MiniBatch(
                index=index,
                op=index[_places(op[index], int(own[0]))],
                vp=index[_places(vp[index], int(own[1]))],
                images=int(own[2]),
                learning=[part for part, size in zip(PARTS, shared, strict=True) if size > 0],
            )
            for index, (own, shared) in zip(indices, sizes, strict=True)
        ]

    def _ticks_that_train(self, name: str, rollout: TickRollout) -> Tensor:
        """True where a tick trains the estimator `name`, op or vp, [K, N] bool."""
        if self.model.cfg.perception.replace("oracle", "vp") not in ("renet", name):
            return torch.zeros_like(rollout.op_mask)
        if self.cfg.estimator_data == "all":
            return torch.ones_like(rollout.op_mask)
        return rollout.op_mask if name == "op" else ~rollout.op_mask

    def _step(self, rollout: TickRollout, batch: MiniBatch) -> dict[str, Tensor]:
        """One gradient step; returns the losses."""
        self.optimizer.zero_grad()
        rest, vp = side_by_side(
            partial(self._gradient, self._blind_losses, rollout, batch),
            partial(self._gradient, self._vp_losses, rollout, batch),
        )
        distributed.average_gradients([p for part in batch.learning for p in self._parts[part]])
        estimators = [p for p in self.parameters if p not in self._apart]
        for parameters in (estimators, self._apart):
            nn.utils.clip_grad_norm_(parameters, self.cfg.max_grad_norm)
        self.optimizer.step()
        return rest | vp

    def _gradient(
        self,
        terms: Callable[[TickRollout, MiniBatch], dict[str, Tensor]],
        rollout: TickRollout,
        batch: MiniBatch,
    ) -> dict[str, Tensor]:
        """Go back through the sum of some terms, scaled as `SupervisionCfg` says; their values."""
        velocity, height = self.cfg.velocity_scale**2, self.cfg.height_scale**2
        weights = {"velocity": velocity, "feet_height": height, "height_map": height}
        weights["far_map"] = height
        losses = terms(rollout, batch)
        if losses:
            scaled = [loss * weights.get(name[3:], 1.0) for name, loss in losses.items()]
            torch.stack(scaled).sum().backward()
        return {name: loss.detach() for name, loss in losses.items()}

    def _blind_losses(self, rollout: TickRollout, batch: MiniBatch) -> dict[str, Tensor]:
        """Terms that share no parameter with VP's."""
        losses = self._losses_of("op", rollout, batch.op)
        return losses | self._anomaly_losses(rollout, batch)

    def _vp_losses(self, rollout: TickRollout, batch: MiniBatch) -> dict[str, Tensor]:
        return self._losses_of("vp", rollout, batch.vp)

    def _losses_of(self, name: str, rollout: TickRollout, index: Tensor) -> dict[str, Tensor]:
        """`estimator_losses` in the environments of `index`.

        Nothing is returned where there are none: gradients of zero would let Adam's momentum move
        an estimator that does not learn.
        """
        return self.estimator_losses(name, rollout.environments(index)) if len(index) else {}

    def estimator_losses(self, name: str, rollout: TickRollout) -> dict[str, Tensor]:
        """Every term of the loss of the estimator `name`, op or vp, over the ticks that train it.

        Returns:
            Named scalars; absent heads are absent.
        """
        counts = self._ticks_that_train(name, rollout).float()
        estimator, him = getattr(self.model, name), getattr(self.model, f"{name}_him")
        initial = getattr(rollout, f"latent_{name}")[0]
        # OP does not look at images.
        frames = rollout.frames.float() if name == "vp" else rollout.frames
        images = frames, rollout.has_image
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

    def _anomaly_losses(self, rollout: TickRollout, batch: MiniBatch) -> dict[str, Tensor]:
        """The detector's losses on some of a mini-batch's image pairs, randomly drawn."""
        if not batch.images:
            return {}
        pairs = self._draw_pairs(rollout, batch)
        if self.model.cfg.detector == "variance":
            pairs = grow_grass(pairs, self._grass)
        return self.model.autoencoder.loss(pairs)

    def _draw_pairs(self, rollout: TickRollout, batch: MiniBatch) -> Tensor:
        """Some of a mini-batch's image pairs, [B, 2, 48, 64], randomly drawn."""
        count = min(self.cfg.autoencoder_images, math.ceil(AUTOENCODER_SHARE * batch.images))
        drawn = torch.randperm(batch.images, device=batch.index.device)[:count]
        seen = rollout.has_image[:, batch.index]
        place = _places(seen.flatten(), batch.images)[drawn]
        tick, robot = place // seen.shape[1], place % seen.shape[1]
        return rollout.frames[tick, batch.index[robot]].float()


def _places(mask: Tensor, count: int) -> Tensor:
    """Where a mask [B] is true, [count]; as it is known how often, a GPU is not waited for."""
    return torch.nonzero_static(mask, size=count).squeeze(-1)


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
