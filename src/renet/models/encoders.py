"""Fusion of embedded vectors, in the paper's two forms: an MLP or single-head self-attention."""

import math

import torch
from torch import Tensor, nn


class MlpEncoder(nn.Module):
    """Concatenate the embeddings ([B, width] each) and compress them to [B, out]."""

    def __init__(self, inputs: int, width: int, out: int) -> None:
        super().__init__()
        self.fuse = nn.Sequential(
            nn.Linear(inputs * width, out),
            nn.ELU(inplace=True),
            nn.Linear(out, out),
            nn.ELU(inplace=True),
        )

    def forward(self, embeddings: list[Tensor]) -> Tensor:
        """Fuse a list of [B, width] into [B, out]."""
        return self.fuse(torch.cat(embeddings, dim=-1))


class AttentionEncoder(nn.Module):
    """Split the embeddings into tokens and fuse them by one layer, one head of attention.

    Reference: RENet, Method A, "Transformer-based feature fusion"; Vaswani et al. 2017. Tokens keep
    a learned position so that proprioception and vision stay distinguishable.
    """

    def __init__(self, inputs: int, width: int, out: int, tokens_per_input: int = 4) -> None:
        super().__init__()
        self.token_size = width // tokens_per_input
        tokens = inputs * tokens_per_input
        self.position = nn.Parameter(0.02 * torch.randn(tokens, self.token_size))
        self.query_key_value = nn.Linear(self.token_size, 3 * self.token_size)
        self.norm = nn.LayerNorm(self.token_size)
        self.compress = nn.Sequential(
            nn.Linear(tokens * self.token_size, out), nn.ELU(inplace=True)
        )

    def forward(self, embeddings: list[Tensor]) -> Tensor:
        """Fuse a list of [B, width] into [B, out]."""
        tokens = torch.cat(embeddings, dim=-1).unflatten(-1, (-1, self.token_size)) + self.position
        query, key, value = self.query_key_value(tokens).chunk(3, dim=-1)
        weights = torch.softmax(query @ key.transpose(-1, -2) / math.sqrt(self.token_size), dim=-1)
        return self.compress(torch.flatten(self.norm(tokens + weights @ value), 1))


ENCODERS: dict[str, type[nn.Module]] = {"attention": AttentionEncoder, "mlp": MlpEncoder}
