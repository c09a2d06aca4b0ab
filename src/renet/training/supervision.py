"""Supervised losses: Loss_OP (RENet eq. 1), Loss_VP (eq. 2) and Loss_ad (eq. 4)."""

from __future__ import annotations

import torch
import torch.nn.functional as functional
from torch import Tensor, nn

from renet.models.autoencoder import anomaly_score
from renet.models.estimators import Estimator
from renet.models.him import HybridInternalModel
from renet.models.renet import RENet
from renet.training import distributed
from renet.training.config import SupervisionCfg
from renet.training.storage import TickRollout


def estimator_losses(
    estimator: Estimator,
    him: HybridInternalModel | None,
    rollout: TickRollout,
    initial: Tensor,
    chosen: Tensor,
) -> dict[str, Tensor]:
    """Every term of an estimator's loss over the ticks in `chosen`.

    Args:
        rollout: sequences of B environments. initial: latent before the first tick, [B, 64].
        chosen: [K, B] bool, the ticks that count; none may.

    Returns:
        Named scalars; their sum is the loss. Absent heads are absent.
    """
    mine = chosen.any(dim=0)
    if not mine.any():
        return {}
    # The others contribute nothing: half the time, most of VP's images.
    rollout, initial, chosen = rollout.environments(mine), initial[mine], chosen[:, mine]
    latent = estimator.unroll(rollout.history, rollout.frames.float(), initial, rollout.fresh)
    estimate = estimator.predict(latent[chosen])
    losses = {}
    for name in ("velocity", "feet_height", "height_map"):
        predicted = getattr(estimate, name)
        if predicted is not None:
            losses[name] = functional.mse_loss(predicted, getattr(rollout, name)[chosen])
    if him is not None:
        paired = chosen & rollout.next_valid
        if paired.any():
            losses["him"] = him(latent[paired], rollout.next_proprioception[paired])
    return losses


class Supervision:
    """Trains both estimators, their HIM and the autoencoder; owns their optimiser."""

    def __init__(self, model: RENet, cfg: SupervisionCfg) -> None:
        self.model, self.cfg = model, cfg
        self.parameters = model.supervised_parameters()
        self.optimizer = torch.optim.Adam(self.parameters, lr=cfg.learning_rate)

    def update(self, rollout: TickRollout) -> dict[str, float]:
        """Learn from one rollout's ticks; returns mean losses by name."""
        environments = rollout.op_mask.shape[1]
        totals: dict[str, list[Tensor]] = {}
        for _ in range(self.cfg.num_learning_epochs):
            order = torch.randperm(environments, device=rollout.op_mask.device)
            for index in order.chunk(self.cfg.num_mini_batches):
                losses = self.losses(rollout.environments(index))
                self.optimizer.zero_grad()
                self.weighted(losses).backward()
                distributed.average_gradients(self.parameters)
                nn.utils.clip_grad_norm_(self.parameters, self.cfg.max_grad_norm)
                self.optimizer.step()
                for name, loss in losses.items():
                    totals.setdefault(name, []).append(loss.detach())
        return {name: float(torch.stack(values).mean()) for name, values in totals.items()}

    def weighted(self, losses: dict[str, Tensor]) -> Tensor:
        """Sum of the terms in the scaled units of `SupervisionCfg`; logs are in m/s and m."""
        weights = {
            "velocity": self.cfg.velocity_scale**2,
            "feet_height": self.cfg.height_scale**2,
            "height_map": self.cfg.height_scale**2,
        }
        terms = [loss * weights.get(name[3:], 1.0) for name, loss in losses.items()]
        return torch.stack(terms).sum()

    def losses(self, rollout: TickRollout) -> dict[str, Tensor]:
        """All supervised terms of a batch of sequences, as `op_NAME`, `vp_NAME` and `anomaly`."""
        model, perception = self.model, self.model.cfg.perception
        losses: dict[str, Tensor] = {}
        if perception in ("renet", "op"):
            chosen = self._chosen(rollout.op_mask)
            terms = estimator_losses(model.op, model.op_him, rollout, rollout.latent_op, chosen)
            losses |= {f"op_{name}": value for name, value in terms.items()}
        if perception in ("renet", "vp"):
            chosen = self._chosen(~rollout.op_mask)
            terms = estimator_losses(model.vp, model.vp_him, rollout, rollout.latent_vp, chosen)
            losses |= {f"vp_{name}": value for name, value in terms.items()}
        return losses | {"anomaly": self._anomaly_loss(rollout.frames)}

    def _chosen(self, own: Tensor) -> Tensor:
        """Ticks that train an estimator, given those it steers."""
        return own if self.cfg.estimator_data == "own" else torch.ones_like(own)

    def _anomaly_loss(self, frames: Tensor) -> Tensor:
        """Loss_ad on randomly drawn image pairs."""
        pairs = frames.flatten(0, 1)
        count = min(self.cfg.autoencoder_images, pairs.shape[0])
        pairs = pairs[torch.randperm(pairs.shape[0], device=pairs.device)[:count]].float()
        return anomaly_score(pairs, self.model.autoencoder(pairs)).mean()
