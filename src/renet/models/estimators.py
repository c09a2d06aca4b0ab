"""The redundant pair: OP (proprioception only) and VP (vision and proprioception).

Each embeds its inputs, fuses them, and carries a one-layer GRU whose 64-wide output is both its
memory and the latent the actor reads (h_b for OP, h_v for VP). Heads are training's business,
except that the runtime also reports what they predict.
"""

import math

import torch
from torch import Tensor, nn

from renet.interface import (
    DEPTH_SHAPE,
    FAR_MAP_SIZE,
    HEIGHT_MAP_SIZE,
    HEIGHT_MAP_X,
    LATENT,
    NUM_FEET,
    PROPRIOCEPTION_SIZE,
)
from renet.models.actor_critic import mlp
from renet.models.config import ModelCfg

EMBEDDING = 64
"""Width of every embedded vector."""
FIRST_LOG_VARIANCE = -5.0
"""Log variance of the height map's error before training: 8 cm."""
TOKEN = 16
"""Width of the attention's tokens, four to an embedded vector."""


class ProprioceptionEmbedding(nn.Sequential):
    """Two-layer MLP for o_t^{H1}: [B, H1, 45] to [B, 64]."""

    def __init__(self, history: int) -> None:
        layers = mlp((history * PROPRIOCEPTION_SIZE, 2 * EMBEDDING, EMBEDDING))
        super().__init__(nn.Flatten(), *layers, nn.ELU(inplace=True))


def _compressor(inputs: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inputs, EMBEDDING), nn.ELU(inplace=True))


class DepthEmbedding(nn.Module):
    """Three-layer CNN for d_t^{H2}: [B, H2, 48, 64] in [0, 1] to [B, 64]."""

    def __init__(self, frames: int) -> None:
        super().__init__()
        self.convolutions = nn.Sequential(
            nn.Conv2d(frames, 16, 5, stride=2, padding=2),
            nn.ELU(inplace=True),
            nn.Conv2d(16, 32, 3, stride=2, padding=1),
            nn.ELU(inplace=True),
            nn.Conv2d(32, 32, 3, stride=2, padding=1),
            nn.ELU(inplace=True),
        )
        # A third faster on a CPU.
        self.convolutions.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        rows, columns = (size // 8 for size in DEPTH_SHAPE)
        self.project = _compressor(32 * rows * columns)

    def forward(self, depth: Tensor) -> Tensor:
        """Embed depth images; centring them keeps the first layer's inputs zero-mean."""
        return self.project(torch.flatten(self.convolutions(depth - 0.5), 1))


class MlpEncoder(nn.Module):
    """Concatenate the embeddings ([B, 64] each) and compress them to [B, 64]."""

    def __init__(self, inputs: int) -> None:
        super().__init__()
        layers = mlp((inputs * EMBEDDING, EMBEDDING, EMBEDDING))
        self.fuse = nn.Sequential(*layers, nn.ELU(inplace=True))

    def forward(self, embeddings: list[Tensor]) -> Tensor:
        """Fuse a list of [B, 64] into [B, 64]."""
        return self.fuse(torch.cat(embeddings, dim=-1))


class AttentionEncoder(nn.Module):
    """Split the embeddings into tokens and fuse them by one layer, one head of attention.

    Reference: RENet, Method A, "Transformer-based feature fusion"; Vaswani et al. 2017. Tokens keep
    a learned position so that proprioception and vision stay distinguishable.
    """

    def __init__(self, inputs: int) -> None:
        super().__init__()
        tokens = inputs * EMBEDDING // TOKEN
        self.position = nn.Parameter(0.02 * torch.randn(tokens, TOKEN))
        self.query_key_value = nn.Linear(TOKEN, 3 * TOKEN)
        self.norm = nn.LayerNorm(TOKEN)
        self.compress = _compressor(inputs * EMBEDDING)

    def forward(self, embeddings: list[Tensor]) -> Tensor:
        """Fuse a list of [B, 64] into [B, 64]."""
        tokens = torch.cat(embeddings, dim=-1).unflatten(-1, (-1, TOKEN)) + self.position
        query, key, value = self.query_key_value(tokens).chunk(3, dim=-1)
        weights = torch.softmax(query @ key.transpose(-1, -2) / math.sqrt(TOKEN), dim=-1)
        return self.compress(torch.flatten(self.norm(tokens + weights @ value), 1))


ENCODERS: dict[str, type[nn.Module]] = {"attention": AttentionEncoder, "mlp": MlpEncoder}


class Estimator(nn.Module):
    """What OP and VP share: encoder, GRU, velocity head, and unrolling over ticks."""

    def __init__(self, cfg: ModelCfg, inputs: int) -> None:
        super().__init__()
        self.frames = cfg.frames
        self.proprioception = ProprioceptionEmbedding(cfg.history)
        self.encoder = ENCODERS[cfg.encoder](inputs)
        self.gru = nn.GRUCell(EMBEDDING, LATENT)
        self.velocity_head = nn.Linear(LATENT, 3) if cfg.predict_velocity else None

    def features(self, history: Tensor, depth: Tensor, has_image: Tensor) -> Tensor:
        """Encode the inputs of a tick to [B, 64].

        Args:
            history: o^{H1}, [B, H1, 45]. depth: d^{H2}, [B, >=H2, 48, 64]; only VP sees it.
            has_image: [B] or [B, 1], 1 where `depth` holds an image of this tick, 0 where it was
                withheld and VP is to go on from its memory.
        """
        raise NotImplementedError

    def predict(self, latent: Tensor) -> dict[str, Tensor]:
        """Apply the heads to latents [..., 64], h_b or h_v.

        Returns:
            What there is a head for: `velocity` [..., 3] m/s, base frame; `feet_height` [..., 4] m,
            order of interface.LEGS; `height_map` [..., 132] m below the nominal base height,
            interface.HEIGHT_MAP_X by HEIGHT_MAP_Y; `far_map` [..., 30] likewise, of FAR_MAP_X by
            FAR_MAP_Y.
        """
        return {} if self.velocity_head is None else {"velocity": self.velocity_head(latent)}

    def forward(self, history: Tensor, depth: Tensor, has_image: Tensor, latent: Tensor) -> Tensor:
        """One 10 Hz tick: previous latent [B, 64] to the next one."""
        return self.gru(self.features(history, depth, has_image), latent)

    def unroll(
        self, history: Tensor, depth: Tensor, has_image: Tensor, latent: Tensor, fresh: Tensor
    ) -> Tensor:
        """Replay T ticks with gradients through time; returns latents [T, B, 64].

        Args:
            history: [T, B, H1, 45]. depth: [T, B, H2, 48, 64]. has_image: [T, B].
            latent: [B, 64] before the first tick.
            fresh: [T, B] bool, true where an episode began since the previous tick, so that its
                memory starts from zero.
        """
        ticks, batch = fresh.shape
        inputs = (values.flatten(0, 1) for values in (history, depth, has_image))
        features = self.features(*inputs).unflatten(0, (ticks, batch))
        latents = []
        for feature, is_fresh in zip(features, fresh, strict=True):
            latent = self.gru(feature, latent * ~is_fresh.unsqueeze(-1))
            latents.append(latent)
        return torch.stack(latents)


class OPEstimator(Estimator):
    """Proprioception only: never sees depth."""

    def __init__(self, cfg: ModelCfg) -> None:
        super().__init__(cfg, inputs=1)

    def features(self, history: Tensor, depth: Tensor, has_image: Tensor) -> Tensor:
        """Encode o^{H1} [B, H1, 45] to [B, 64]; images are ignored."""
        return self.encoder([self.proprioception(history)])


class VPEstimator(Estimator):
    """Vision and proprioception: also predicts feet height h_f and the 2.5D height map m_t."""

    def __init__(self, cfg: ModelCfg) -> None:
        super().__init__(cfg, inputs=2)
        self.depth = DepthEmbedding(cfg.frames)
        self.feet_height_head = nn.Linear(LATENT, NUM_FEET) if cfg.predict_feet_height else None
        self.height_map_head = (
            mlp((LATENT, LATENT, HEIGHT_MAP_SIZE)) if cfg.predict_height_map else None
        )
        far = cfg.predict_far_map
        self.far_map_head = mlp((LATENT, LATENT, FAR_MAP_SIZE)) if far else None
        judged = cfg.predict_map_error and cfg.predict_height_map
        self.map_error_head = mlp((LATENT, LATENT, HEIGHT_MAP_SIZE)) if judged else None
        if self.map_error_head is not None:
            nn.init.constant_(self.map_error_head[-1].bias, FIRST_LOG_VARIANCE)  # type: ignore[arg-type]

    def features(self, history: Tensor, depth: Tensor, has_image: Tensor) -> Tensor:
        """Encode a tick; where an image was withheld, its embedding is zero."""
        embedding = self.depth(depth[:, : self.frames])
        embedding = embedding * has_image.reshape(-1, 1).to(embedding.dtype)
        return self.encoder([self.proprioception(history), embedding])

    def predict(self, latent: Tensor) -> dict[str, Tensor]:
        """Apply the heads to h_v [..., 64]; what `Estimator.predict` lists, as far as trained."""
        estimate = super().predict(latent)
        if self.feet_height_head is not None:
            estimate["feet_height"] = self.feet_height_head(latent)
        if self.height_map_head is not None:
            estimate["height_map"] = self.height_map_head(latent)
        if self.far_map_head is not None:
            estimate["far_map"] = self.far_map_head(latent)
        return estimate

    def map_log_variance(self, latent: Tensor) -> Tensor:
        """Logarithm of the variance of the height map's error, m^2, from h_v [..., 64].

        Returns:
            [..., 132]. It grows as memory goes stale. No gradient reaches the latent: VP remembers
            the ground, not how to judge itself.
        """
        assert self.map_error_head is not None
        return self.map_error_head(latent.detach())

    def map_error(self, latent: Tensor) -> Tensor:
        """Root mean square of the error to expect of the map ahead, [N] m, from h_v [N, 64]."""
        variance = self.map_log_variance(latent).exp().unflatten(-1, (len(HEIGHT_MAP_X), -1))
        ahead = variance[:, [i for i, x in enumerate(HEIGHT_MAP_X) if x > 0.0]]
        return ahead.mean((-2, -1)).sqrt()
