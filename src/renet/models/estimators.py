"""Redundant pair of estimators: OP (proprioception only) and VP (vision and proprioception).

Each embeds its inputs, fuses them, and advances a one-layer GRU. The GRU's 64-wide output is both
the estimator's memory and the latent that the actor reads (h_b of OP, h_v of VP). Heads, which
predict velocity and ground from the latent, are for training; the actor does not read them.
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
FIRST_MAP_LOG_VARIANCE = -5.0
"""Log variance of the height map's error before training: 8 cm."""
TOKEN = 16
"""Width of the attention's tokens, four to an embedded vector."""


class ProprioceptionEmbedding(nn.Sequential):
    """Two-layer MLP that embeds o_t^{H1}: [B, H1, 45] to [B, 64]."""

    def __init__(self, history: int) -> None:
        layers = mlp((history * PROPRIOCEPTION_SIZE, 2 * EMBEDDING, EMBEDDING))
        super().__init__(nn.Flatten(), *layers, nn.ELU(inplace=True))


def _compressor(inputs: int) -> nn.Sequential:
    """Build a layer [B, inputs] to [B, 64]."""
    return nn.Sequential(nn.Linear(inputs, EMBEDDING), nn.ELU(inplace=True))


def _map_head(points: int) -> nn.Sequential:
    """Build layers from a latent [B, 64] to a map [B, points]."""
    return mlp((LATENT, LATENT, points))


class DepthEmbedding(nn.Module):
    """Three-layer CNN that embeds d_t^{H2}: [B, H2, 48, 64] in [0, 1] to [B, 64]."""

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
        """Embed depth images, [B, H2, 48, 64] to [B, 64]."""
        # Images around zero rather than around a half.
        features = self.convolutions(depth - 0.5)
        return self.project(torch.flatten(features, 1))


class MlpEncoder(nn.Module):
    """Fusion of embeddings ([B, 64] each) by an MLP of their concatenation."""

    def __init__(self, inputs: int) -> None:
        super().__init__()
        layers = mlp((inputs * EMBEDDING, EMBEDDING, EMBEDDING))
        self.fuse = nn.Sequential(*layers, nn.ELU(inplace=True))

    def forward(self, embeddings: list[Tensor]) -> Tensor:
        """Fuse a list of [B, 64] into [B, 64]."""
        return self.fuse(torch.cat(embeddings, dim=-1))


class AttentionEncoder(nn.Module):
    """Fusion of embeddings ([B, 64] each), split into tokens, by one layer and head of attention.

    Reference: RENet, Method A, "Transformer-based feature fusion"; Vaswani et al. 2017. A learned
    position of each token tells proprioception from vision.
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
        # A residual connection around the attention, then a normalisation.
        output = self.norm(tokens + weights @ value)
        return self.compress(torch.flatten(output, 1))


ENCODERS: dict[str, type[nn.Module]] = {"attention": AttentionEncoder, "mlp": MlpEncoder}


class Estimator(nn.Module):
    """Base of OP and VP: encoder, GRU, heads, and unrolling over ticks."""

    quantities: tuple[str, ...] = ("velocity",)
    """Quantities that the heads predict. Each head is an attribute, such as `velocity_head`, or
    None where `ModelCfg` leaves it out."""

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
            history: Proprioceptions o^{H1}, [B, H1, 45].
            depth: Depth images d^{H2} in [0, 1], [B, >=H2, 48, 64]; OP does not read them.
            has_image: 1 where `depth` holds an image of this tick, 0 where it was withheld and VP
                continues from its memory, [B] or [B, 1].
        """
        raise NotImplementedError

    def predict(self, latent: Tensor) -> dict[str, Tensor]:
        """Apply the heads to latents [..., 64], h_b or h_v.

        Returns:
            Predictions by quantity, one for each head: `velocity` [..., 3] m/s in the base frame;
            `feet_height` [..., 4] m in the order of interface.LEGS; `height_map` [..., 132] m below
            the nominal base height, interface.HEIGHT_MAP_X by HEIGHT_MAP_Y; `far_map` [..., 30]
            likewise, FAR_MAP_X by FAR_MAP_Y.
        """
        predictions = {}
        for name in self.quantities:
            head = getattr(self, f"{name}_head")
            if head is not None:
                predictions[name] = head(latent)
        return predictions

    def forward(self, history: Tensor, depth: Tensor, has_image: Tensor, latent: Tensor) -> Tensor:
        """Advance latents [B, 64] by one 10 Hz tick; other arguments are those of `features`."""
        return self.gru(self.features(history, depth, has_image), latent)

    def unroll(
        self, history: Tensor, depth: Tensor, has_image: Tensor, latent: Tensor, fresh: Tensor
    ) -> Tensor:
        """Replay T ticks, with gradients through time.

        Args:
            history: Proprioceptions o^{H1}, [T, B, H1, 45].
            depth: Depth images in [0, 1], [T, B, H2, 48, 64].
            has_image: 1 where a tick had an image, [T, B].
            latent: Latents before the first tick, [B, 64].
            fresh: True where an episode began since the previous tick, [T, B] bool; its memory
                starts from zero.

        Returns:
            Latents after each tick, [T, B, 64].
        """
        ticks, batch = fresh.shape
        # Encode all ticks in one batch; only the GRU needs them in order.
        features = self.features(
            history.flatten(0, 1), depth.flatten(0, 1), has_image.flatten(0, 1)
        ).unflatten(0, (ticks, batch))
        latents = []
        for feature, is_fresh in zip(features, fresh, strict=True):
            latent = self.gru(feature, latent * ~is_fresh.unsqueeze(-1))
            latents.append(latent)
        return torch.stack(latents)


class OPEstimator(Estimator):
    """Estimator from proprioception alone."""

    def __init__(self, cfg: ModelCfg) -> None:
        super().__init__(cfg, inputs=1)

    def features(self, history: Tensor, depth: Tensor, has_image: Tensor) -> Tensor:
        """Encode o^{H1} [B, H1, 45] to [B, 64]; images are ignored."""
        return self.encoder([self.proprioception(history)])


class VPEstimator(Estimator):
    """Estimator from vision and proprioception.

    It also predicts the heights h_f of the feet, the 2.5D height map m_t and the ground beyond it.
    """

    quantities = ("velocity", "feet_height", "height_map", "far_map")

    def __init__(self, cfg: ModelCfg) -> None:
        super().__init__(cfg, inputs=2)
        self.depth = DepthEmbedding(cfg.frames)
        self.feet_height_head = nn.Linear(LATENT, NUM_FEET) if cfg.predict_feet_height else None
        self.height_map_head = _map_head(HEIGHT_MAP_SIZE) if cfg.predict_height_map else None
        self.far_map_head = _map_head(FAR_MAP_SIZE) if cfg.predict_far_map else None
        self.map_error_head = None
        if cfg.predict_map_error and cfg.predict_height_map:
            self.map_error_head = _map_head(HEIGHT_MAP_SIZE)
            nn.init.constant_(self.map_error_head[-1].bias, FIRST_MAP_LOG_VARIANCE)  # type: ignore[arg-type]

    def features(self, history: Tensor, depth: Tensor, has_image: Tensor) -> Tensor:
        """Encode the inputs of a tick to [B, 64]; a withheld image has an embedding of zero."""
        embedding = self.depth(depth[:, : self.frames])
        embedding = embedding * has_image.reshape(-1, 1).to(embedding.dtype)
        return self.encoder([self.proprioception(history), embedding])

    def map_log_variance(self, latent: Tensor) -> Tensor:
        """Predict the log variance of the height map's error from latents h_v [..., 64].

        The error grows as VP's memory of the ground gets old. No gradient reaches the latent, which
        is to hold the ground and not the reliability of its own prediction.

        Returns:
            Logarithm of the variance in m^2, [..., 132].
        """
        assert self.map_error_head is not None
        return self.map_error_head(latent.detach())

    def map_error(self, latent: Tensor) -> Tensor:
        """Predict the root mean square error of the map ahead of the robot.

        Args:
            latent: Latents h_v, [N, 64].

        Returns:
            Error in m, [N], over the map's points at x > 0.
        """
        variance = self.map_log_variance(latent).exp().unflatten(-1, (len(HEIGHT_MAP_X), -1))
        rows_ahead = [row for row, x in enumerate(HEIGHT_MAP_X) if x > 0.0]
        return variance[:, rows_ahead].mean((-2, -1)).sqrt()
