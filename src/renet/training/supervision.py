"""Supervised losses: Loss_OP (RENet eq. 1), Loss_VP (eq. 2), Loss_ad (eq. 4); expected images."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from renet.models.expectation import Recollection
from renet.models.him import target_view
from renet.models.renet import RENet
from renet.tasks.schedule import value_at
from renet.training import distributed
from renet.training.config import SupervisionCfg
from renet.training.grass import Grass
from renet.training.precision import compute_in, side_by_side
from renet.training.storage import TickRollout

LEARNERS = ("op", "vp", "detector")
"""Networks trained by supervision: both estimators with their HIM, and the detector, to which the
expectation of images belongs."""
AUTOENCODER_SHARE = 0.4
"""Largest share of a mini-batch's image pairs that the autoencoder learns from. A few robots have
few pairs, all much alike: from all of them it would learn longer than both estimators together."""


@dataclass
class MiniBatch:
    """Some environments of a rollout, and the networks that learn from them."""

    index: Tensor
    """Environments, [B]."""
    op: Tensor
    """Those with ticks that train OP, [<= B]."""
    vp: Tensor
    """Those with ticks that train VP, [<= B]."""
    images: int
    """Number of ticks with an image."""
    learners: list[str]
    """The `LEARNERS` for which any rank has data in this mini-batch."""


class Supervision:
    """Supervised learning of both estimators, their HIM and the autoencoder."""

    def __init__(
        self, model: RENet, cfg: SupervisionCfg, dtype: torch.dtype = torch.float32
    ) -> None:
        """Initialize the optimizer.

        Args:
            model: All networks, on the device where they learn.
            cfg: Settings of supervision.
            dtype: Type in which the depth embedding computes while it learns.
        """
        self.model = model
        self.cfg = cfg
        self.dtype = dtype
        self.parameters = model.supervised_parameters()
        self._parts = {
            "op": _parameters(model.op, model.op_him),
            "vp": _parameters(model.vp, model.vp_him),
            "detector": _parameters(model.autoencoder, model.expectation),
        }
        # Likelihoods have large gradients, which are clipped on their own so that they do not
        # shorten the estimators' steps. A dictionary, because a set has no fixed order, on which
        # the last bit of a gradient's norm depends.
        likelihoods = _parameters(model.autoencoder, model.vp.map_error_head, model.expectation)
        self._likelihoods = dict.fromkeys(likelihoods)
        # A scale of a quantity is a weight of its squared error. Other losses have a weight of 1.
        velocity = cfg.velocity_scale**2
        height = cfg.height_scale**2
        self._weights = {
            "op_velocity": velocity,
            "vp_velocity": velocity,
            "vp_feet_height": height,
            "vp_height_map": height,
            "vp_far_map": height,
        }
        self.grass: Grass | None = None
        """Grass before images, through which the variance detector learns to look."""
        if model.cfg.detector == "variance":
            self.grass = Grass(self.parameters[0].device)
        rate = value_at(cfg.learning_rate, 0.0)
        self.optimizer = torch.optim.Adam(self.parameters, lr=rate, fused=True)

    def update(self, rollout: TickRollout, steps: float = 0.0) -> dict[str, Tensor]:
        """Learn from one rollout. This waits for a GPU once in each epoch, and at the end.

        Args:
            rollout: The ticks.
            steps: Environment steps taken before the rollout, for a learning rate that follows a
                schedule.

        Returns:
            Mean losses over all gradient steps by name, and of each HIM the effective rank and the
            usage of its prototypes.
        """
        self.optimizer.param_groups[0]["lr"] = value_at(self.cfg.learning_rate, steps)

        # Take one gradient step for each mini-batch of each epoch.
        history: dict[str, list[Tensor]] = {}
        with compute_in(self.dtype, self.model.vp.depth):
            for _ in range(self.cfg.num_learning_epochs):
                for batch in self.draw_mini_batches(rollout):
                    for name, loss in self._step(rollout, batch).items():
                        history.setdefault(name, []).append(loss)

        # Average the losses over the gradient steps that had them.
        losses = {name: torch.stack(values).mean() for name, values in history.items()}
        for name in ("op", "vp"):
            if f"{name}_him" in losses:
                him = getattr(self.model, f"{name}_him")
                losses[f"{name}_him_rank"] = him.effective_rank()
                losses[f"{name}_him_usage"] = him.usage
        return losses

    @torch.no_grad()
    def draw_mini_batches(self, rollout: TickRollout) -> list[MiniBatch]:
        """Divide a rollout's environments into random mini-batches, for one epoch.

        The host must know the sizes of all selections. It fetches them from a GPU at once, because
        each selection by a mask would wait for the device.
        """
        op = self._training_ticks("op", rollout).any(dim=0)
        vp = self._training_ticks("vp", rollout).any(dim=0)
        images = rollout.has_image.sum(dim=0)
        order = torch.randperm(len(op), device=op.device)
        indices = order.chunk(self.cfg.num_mini_batches)

        # Count what each learner finds in each mini-batch, [mini-batches, learners], with the
        # learners in the order of LEARNERS.
        per_environment = torch.stack((op, vp, images)).double()
        local = torch.stack([per_environment[:, index].sum(dim=-1) for index in indices])
        mean = distributed.mean(local)
        sizes = torch.stack((local, mean), dim=1).tolist()

        batches = []
        for index, (local_sizes, mean_sizes) in zip(indices, sizes, strict=True):
            op_size, vp_size, image_count = map(int, local_sizes)
            # A mean above 0 says that some rank has data, so that all ranks agree on it.
            learners = [name for name, size in zip(LEARNERS, mean_sizes, strict=True) if size > 0]
            batch = MiniBatch(
                index=index,
                op=index[_true_indices(op[index], op_size)],
                vp=index[_true_indices(vp[index], vp_size)],
                images=image_count,
                learners=learners,
            )
            batches.append(batch)
        return batches

    def _training_ticks(self, name: str, rollout: TickRollout) -> Tensor:
        """Return a mask of the ticks that train the estimator `name` (op or vp), [K, N] bool."""
        # The oracle is a VP that sees the true height map.
        perception = self.model.cfg.perception.replace("oracle", "vp")
        if perception not in ("renet", name):
            return torch.zeros_like(rollout.op_mask)
        if self.cfg.estimator_data == "all":
            return torch.ones_like(rollout.op_mask)
        return rollout.op_mask if name == "op" else ~rollout.op_mask

    def _step(self, rollout: TickRollout, batch: MiniBatch) -> dict[str, Tensor]:
        """Take one gradient step; returns losses by name."""
        # Compute the gradients of VP beside all others, with which it shares no parameter.
        self.optimizer.zero_grad()
        blind_losses, vp_losses = side_by_side(
            lambda: self._backward(self._blind_losses(rollout, batch)),
            lambda: self._backward(self._vp_losses(rollout, batch)),
        )

        # Average the gradients of the learners over ranks.
        parameters = []
        for name in batch.learners:
            parameters += self._parts[name]
        distributed.average_gradients(parameters)

        # Clip the estimators' gradients, and on their own those of likelihoods.
        estimators = [p for p in self.parameters if p not in self._likelihoods]
        nn.utils.clip_grad_norm_(estimators, self.cfg.max_grad_norm)
        nn.utils.clip_grad_norm_(self._likelihoods, self.cfg.max_grad_norm)
        self.optimizer.step()
        return blind_losses | vp_losses

    def _backward(self, losses: dict[str, Tensor]) -> dict[str, Tensor]:
        """Compute the gradients of the weighted sum of losses; returns the losses, detached."""
        if losses:
            weighted = [loss * self._weights.get(name, 1.0) for name, loss in losses.items()]
            torch.stack(weighted).sum().backward()
        return {name: loss.detach() for name, loss in losses.items()}

    def _blind_losses(self, rollout: TickRollout, batch: MiniBatch) -> dict[str, Tensor]:
        """Compute the losses of OP and of the detectors, which share no parameter with VP's."""
        losses = self.estimator_losses("op", rollout.environments(batch.op))
        losses |= self._anomaly_losses(rollout, batch)
        return losses | self._expectation_losses(rollout, batch)

    def _vp_losses(self, rollout: TickRollout, batch: MiniBatch) -> dict[str, Tensor]:
        """Compute the losses of VP."""
        return self.estimator_losses("vp", rollout.environments(batch.vp))

    def estimator_losses(self, name: str, rollout: TickRollout) -> dict[str, Tensor]:
        """Compute all losses of an estimator over the ticks that train it.

        Args:
            name: Name of the estimator, op or vp.
            rollout: The ticks.

        Returns:
            Scalars by name, such as `vp_height_map`; a head that the model lacks has none. Without
            robots there are no losses: gradients of zero would not do, because Adam's momentum
            would move an estimator that does not learn.
        """
        if not rollout.fresh.shape[1]:
            return {}
        counts = self._training_ticks(name, rollout).float()
        estimator = getattr(self.model, name)
        him = getattr(self.model, f"{name}_him")

        def mean(loss: Tensor) -> Tensor:
            """Average a loss [K, B, ...] over the ticks that train the estimator."""
            return (loss.mean(-1) * counts).sum() / counts.sum().clamp_min(1.0)

        # Replay the estimator's memory. OP reads no images, which need no conversion for it.
        frames = rollout.frames.float() if name == "vp" else rollout.frames
        initial = getattr(rollout, f"latent_{name}")[0]
        latent = estimator.unroll(
            rollout.history, frames, rollout.has_image, initial, rollout.fresh
        )

        # Heads: mean squared errors.
        losses = {}
        squares = {}
        for head, prediction in estimator.predict(latent).items():
            squares[head] = (prediction - getattr(rollout, head)).square()
            losses[f"{name}_{head}"] = mean(squares[head])

        # Error of the height map: Gaussian likelihood, which does not train the map itself.
        if name == "vp" and estimator.map_error_head is not None:
            log_variance = estimator.map_log_variance(latent)
            ratio = squares["height_map"].detach() / log_variance.exp()
            losses["vp_map_nll"] = mean(0.5 * (ratio + log_variance))

        # HIM: latents against the states one control step later, within the same episode.
        if him is not None:
            pairs = (counts * rollout.next_valid).flatten()
            target = target_view(rollout.next_proprioception, rollout.next_velocity)
            losses[f"{name}_him"] = him(latent.flatten(0, 1), target.flatten(0, 1), pairs)
        return losses

    def _anomaly_losses(self, rollout: TickRollout, batch: MiniBatch) -> dict[str, Tensor]:
        """Compute the detector's losses on a random sample of a mini-batch's image pairs."""
        if not batch.images:
            return {}
        pairs = self._draw_pairs(rollout, batch)
        if self.grass is not None:
            pairs = self.grass.before_pairs(pairs)
        return self.model.autoencoder.loss(pairs)

    def _expectation_losses(self, rollout: TickRollout, batch: MiniBatch) -> dict[str, Tensor]:
        """Compute the loss of the expected images in all ticks after a robot's first.

        VP's latents are those of the rollout, so that no gradient reaches VP.
        """
        expectation = self.model.expectation
        if expectation is None or not batch.images:
            return {}

        def of_batch(tensor: Tensor) -> Tensor:
            """Select the mini-batch's rows of a tensor [K, N, ...], [K * B, ...]."""
            return tensor[:, batch.index].flatten(0, 1)

        known = Recollection(
            latent=of_batch(rollout.latent_vp),
            history=of_batch(rollout.history),
            blocks=of_batch(rollout.last_blocks).float(),
            age=of_batch(rollout.image_age),
        )
        loss = expectation.loss(known, of_batch(rollout.blocks).float())
        # The first tick of an episode has no last image.
        has_last = (~of_batch(rollout.fresh)).float()
        return {"expectation": (loss * has_last).sum() / has_last.sum().clamp_min(1.0)}

    def _draw_pairs(self, rollout: TickRollout, batch: MiniBatch) -> Tensor:
        """Draw a random sample of a mini-batch's image pairs, [B, 2, 48, 64]."""
        count = min(self.cfg.autoencoder_images, math.ceil(AUTOENCODER_SHARE * batch.images))
        sample = torch.randperm(batch.images, device=batch.index.device)[:count]
        # Positions of the sample among all ticks and environments of the mini-batch.
        has_image = rollout.has_image[:, batch.index]
        position = _true_indices(has_image.flatten(), batch.images)[sample]
        tick = position // has_image.shape[1]
        environment = batch.index[position % has_image.shape[1]]
        return rollout.frames[tick, environment].float()


def _parameters(*modules: nn.Module | None) -> list[nn.Parameter]:
    """List the parameters of all modules that are not None."""
    parameters: list[nn.Parameter] = []
    for module in modules:
        if module is not None:
            parameters += module.parameters()
    return parameters


def _true_indices(mask: Tensor, count: int) -> Tensor:
    """Return the indices [count] at which a mask [B] is true.

    The caller knows their number, so that this does not wait for a GPU to count them.
    """
    return torch.nonzero_static(mask, size=count).squeeze(-1)
