"""From trained networks to the three ONNX models a robot runs (paper, Experimental Setup)."""

from __future__ import annotations

import io
import warnings

import torch
from torch import Tensor, nn

from renet.errors import RenetError
from renet.interface import (
    DEPTH_SHAPE,
    FEET,
    FRAMES,
    HEIGHT_MAP_SIZE,
    LATENT,
    PROPRIOCEPTION_SIZE,
)
from renet.models.actor_critic import fuse
from renet.models.autoencoder import anomaly_score, variance_score
from renet.models.renet import RENet

OPSET = 17
"""Old enough for the ONNX Runtime of a robot's computer, new enough for LayerNormalization."""


class ActorGraph(nn.Module):
    """50 Hz: o_t, both latents and the paper's mask to an action."""

    inputs = ("proprioception", "latent_op", "latent_vp", "op_mask")
    outputs = ("action",)

    def __init__(self, model: RENet) -> None:
        super().__init__()
        self.actor = model.actor

    def forward(
        self, proprioception: Tensor, latent_op: Tensor, latent_vp: Tensor, op_mask: Tensor
    ) -> Tensor:
        """Mean action [N, 12]."""
        return self.actor(proprioception, fuse(latent_op, latent_vp, op_mask))


class EstimatorGraph(nn.Module):
    """10 Hz: both estimators, their memories in and out, and what they predict."""

    inputs = ("proprioception_history", "depth", "latent_op", "latent_vp")
    outputs = (
        "next_latent_op",
        "next_latent_vp",
        "velocity_op",
        "velocity_vp",
        "feet_height",
        "height_map",
    )

    def __init__(self, model: RENet) -> None:
        super().__init__()
        self.op, self.vp = model.op, model.vp

    def forward(
        self, history: Tensor, depth: Tensor, latent_op: Tensor, latent_vp: Tensor
    ) -> tuple[Tensor, ...]:
        """Next latents and predictions; a head absent from an ablation predicts zeros."""
        next_op = self.op(history, depth, latent_op)
        next_vp = self.vp(history, depth, latent_vp)
        op, vp = self.op.predict(next_op), self.vp.predict(next_vp)
        predictions = (
            (op.velocity, 3),
            (vp.velocity, 3),
            (vp.feet_height, FEET),
            (vp.height_map, HEIGHT_MAP_SIZE),
        )
        zeros = torch.zeros_like(next_vp[:, :1])
        return (
            next_op,
            next_vp,
            *(zeros.expand(-1, size) if value is None else value for value, size in predictions),
        )


class VisionGraph(nn.Module):
    """10 Hz: the autoencoder, its anomaly score, and that of the variance detector."""

    inputs = ("depth",)

    def __init__(self, model: RENet) -> None:
        super().__init__()
        self.autoencoder = model.autoencoder
        variance = ("variance_score",) if model.cfg.detector == "variance" else ()
        self.outputs = ("reconstruction", "anomaly_score", *variance)

    def forward(self, depth: Tensor) -> tuple[Tensor, ...]:
        """Reconstruction [N, 2, 48, 64], Loss_ad [N], perhaps the variance score [N]."""
        reconstruction, log_variance = self.autoencoder.predict(depth)
        score = anomaly_score(depth, reconstruction)
        if log_variance is None:
            return reconstruction, score
        return reconstruction, score, variance_score(depth, reconstruction, log_variance)


def export_models(model: RENet) -> dict[str, bytes]:
    """The three ONNX models, with a dynamic batch axis, by name.

    Raises:
        RenetError: the model is the Oracle, which needs the simulator's truth.
    """
    cfg = model.cfg
    if cfg.perception == "oracle":
        raise RenetError("the Oracle reads the simulator's truth and cannot be exported")
    proprioception = torch.zeros(2, PROPRIOCEPTION_SIZE)
    history = torch.zeros(2, cfg.history, PROPRIOCEPTION_SIZE)
    depth = torch.zeros(2, FRAMES, *DEPTH_SHAPE)
    latents = torch.zeros(2, LATENT), torch.zeros(2, LATENT)
    model = model.cpu().eval()
    return {
        "actor": _to_onnx(ActorGraph(model), (proprioception, *latents, torch.zeros(2, 1))),
        "estimator": _to_onnx(EstimatorGraph(model), (history, depth, *latents)),
        "vision": _to_onnx(VisionGraph(model), (depth,)),
    }


def _to_onnx(
    graph: ActorGraph | EstimatorGraph | VisionGraph, example: tuple[Tensor, ...]
) -> bytes:
    """Serialise one graph; every input and output has the batch as its first axis."""
    buffer = io.BytesIO()
    with warnings.catch_warnings():
        # The tracing exporter is deprecated but keeps these small graphs free of external data.
        warnings.simplefilter("ignore")
        torch.onnx.export(
            graph,
            example,
            buffer,  # type: ignore[arg-type]
            input_names=list(graph.inputs),
            output_names=list(graph.outputs),
            dynamic_axes={name: {0: "robots"} for name in (*graph.inputs, *graph.outputs)},
            opset_version=OPSET,
            dynamo=False,
        )
    return buffer.getvalue()
