"""Supervised losses: Loss_OP (RENet eq. 1), Loss_VP (eq. 2), Loss_ad (eq. 4); expected images."""

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
from renet.models.expectation import Recollection
from renet.models.him import target_view
from renet.models.renet import RENet
from renet.training import distributed
from renet.training.config import SupervisionCfg, value_at
from renet.training.precision import compute_in, side_by_side
from renet.training.storage import TickRollout

LEARNERS = ("op", "vp", "detector")
"""Networks trained by supervision: both estimators with their HIM, and the detector, to which the
expectation of images belongs."""
AUTOENCODER_SHARE = 0.4
"""Largest share of a mini-batch's image pairs that the autoencoder learns from. A few robots have
few pairs, all much alike: from all of them it would learn longer than both estimators together."""
GRASS_SHARE = 0.15
"""Share of the detector's image pairs with grass. With twice as many it misses other faults."""
GRASS_EVERY = 7
"""Robots from one that learns to expect images with grass to the next: a share of 0.14."""
GRASS_BLADES = 20
"""Largest number of blades in view: the fault `tall_grass` at severity 2 of 5."""
GRASS_VIEWS = 512
"""Number of different views of blades."""


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
        if model.cfg.detector == "variance":
            self._grass = draw_grass().to(self.parameters[0].device)
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

        # Count what each learner finds in each mini-batch: [mini-batches, learners].
        # In the order of LEARNERS.
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

    def grow_grass(self, images: Tensor) -> Tensor:
        """Return images [N, 48, 64] from which to expect others, some of them with grass."""
        if self.model.cfg.detector != "variance":
            return images
        return grow_grass_before_some(images, self._grass)

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
            partial(self._gradient, self._blind_losses, rollout, batch),
            partial(self._gradient, self._vp_losses, rollout, batch),
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

    def _gradient(
        self,
        terms: Callable[[TickRollout, MiniBatch], dict[str, Tensor]],
        rollout: TickRollout,
        batch: MiniBatch,
    ) -> dict[str, Tensor]:
        """Compute the gradients of a sum of losses, scaled as `SupervisionCfg` says.

        Args:
            terms: Function that returns the losses by name.
            rollout: The ticks.
            batch: Environments to learn from.

        Returns:
            The losses, detached and not scaled.
        """
        # A scale of the quantity is a weight of its squared error.
        weights = {
            "velocity": self.cfg.velocity_scale**2,
            "feet_height": self.cfg.height_scale**2,
            "height_map": self.cfg.height_scale**2,
            "far_map": self.cfg.height_scale**2,
        }
        losses = terms(rollout, batch)
        if losses:
            weighted = []
            for name, loss in losses.items():
                head = name[len("vp_") :]
                weighted.append(loss * weights.get(head, 1.0))
            torch.stack(weighted).sum().backward()
        return {name: loss.detach() for name, loss in losses.items()}

    def _blind_losses(self, rollout: TickRollout, batch: MiniBatch) -> dict[str, Tensor]:
        """Compute the losses of OP and of the detectors, which share no parameter with VP's."""
        losses = self._losses_of("op", rollout, batch.op)
        losses |= self._anomaly_losses(rollout, batch)
        return losses | self._expectation_losses(rollout, batch)

    def _vp_losses(self, rollout: TickRollout, batch: MiniBatch) -> dict[str, Tensor]:
        """Compute the losses of VP."""
        return self._losses_of("vp", rollout, batch.vp)

    def _losses_of(self, name: str, rollout: TickRollout, index: Tensor) -> dict[str, Tensor]:
        """Compute `estimator_losses` in the environments `index`, [B].

        Without environments the result is empty. Gradients of zero would not do: Adam's momentum
        would move an estimator that does not learn.
        """
        if len(index) == 0:
            return {}
        return self.estimator_losses(name, rollout.environments(index))

    def estimator_losses(self, name: str, rollout: TickRollout) -> dict[str, Tensor]:
        """Compute all losses of an estimator over the ticks that train it.

        Args:
            name: Estimator, op or vp.
            rollout: The ticks.

        Returns:
            Scalars by name, such as `vp_height_map`; a head that the model lacks has none.
        """
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
        if self.model.cfg.detector == "variance":
            pairs = grow_grass(pairs, self._grass)
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


def draw_grass(seed: int = 0) -> Tensor:
    """Draw random views of blades of grass alone, [512, 48, 64].

    Pixels are depths in [0, 1]: 1 where there is no blade, 0 where one is not measured.
    """
    rng = np.random.default_rng(seed)
    background = Frames.healthy(np.ones((1, *DEPTH_SHAPE), np.float32))
    counts = rng.integers(1, GRASS_BLADES + 1, GRASS_VIEWS)
    views = []
    for count in counts:
        grass = TallGrass(count, [rng])
        views.append(grass.corrupt(background, np.zeros(1)).image[0])
    return torch.from_numpy(np.stack(views))


def grow_grass_before_some(images: Tensor, views: Tensor) -> Tensor:
    """Put grass before every seventh robot's image, each time with a random view of blades.

    Args:
        images: Images of all robots, [N, 48, 64].
        views: Views of blades (see `draw_grass`), [V, 48, 64].
    """
    overgrown = images.clone()
    some = overgrown[::GRASS_EVERY]
    choice = torch.randint(len(views), (len(some),), device=images.device)
    overgrown[::GRASS_EVERY] = torch.minimum(some, views[choice])
    return overgrown


def grow_grass(pairs: Tensor, views: Tensor) -> Tensor:
    """Put grass before the first 15 % of image pairs, each image with a random view of blades.

    Args:
        pairs: Image pairs, [B, 2, 48, 64].
        views: Views of blades (see `draw_grass`), [V, 48, 64].
    """
    count = round(GRASS_SHARE * len(pairs))
    choice = torch.randint(len(views), (count, FRAMES), device=pairs.device)
    # The nearer surface hides the other one.
    overgrown = torch.minimum(pairs[:count], views[choice])
    return torch.cat([overgrown, pairs[count:]])
