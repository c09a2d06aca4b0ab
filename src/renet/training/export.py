"""From trained networks to the three ONNX models a robot runs (paper, Experimental Setup)."""

import io
import warnings
from collections.abc import Iterable

import torch
from torch import Tensor, nn

from renet.deploy.bundle.models import OPTIONAL, model_shapes
from renet.errors import RenetError
from renet.interface import FEET, HEIGHT_MAP_SIZE
from renet.models.actor_critic import fuse
from renet.models.autoencoder import anomaly_score, variance_score
from renet.models.renet import RENet

OPSET = 17
"""Old enough for the ONNX Runtime of a robot's computer, new enough for LayerNormalization."""


class ActorGraph(nn.Module):
    """50 Hz: o_t, both latents and the paper's mask to an action."""

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

    def __init__(self, model: RENet) -> None:
        super().__init__()
        self.autoencoder = model.autoencoder

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
    if model.cfg.perception == "oracle":
        raise RenetError("the Oracle reads the simulator's truth and cannot be exported")
    model, shapes = model.cpu().eval(), model_shapes(model.cfg.history)
    if model.cfg.detector == "variance":
        shapes["vision"][1][OPTIONAL] = ()
    graphs = {"actor": ActorGraph, "estimator": EstimatorGraph, "vision": VisionGraph}
    return {name: _to_onnx(graph(model), *shapes[name]) for name, graph in graphs.items()}


def _to_onnx(graph: nn.Module, inputs: dict[str, tuple[int, ...]], outputs: Iterable[str]) -> bytes:
    """Serialise one graph; every input and output has the batch as its first axis.

    Args:
        graph: to trace. inputs: shapes by name, without the batch. outputs: names.
    """
    buffer, example = io.BytesIO(), tuple(torch.zeros(2, *shape) for shape in inputs.values())
    with warnings.catch_warnings():
        # The tracing exporter is deprecated but keeps these small graphs free of external data.
        warnings.simplefilter("ignore")
        torch.onnx.export(
            graph,
            example,
            buffer,  # type: ignore[arg-type]
            input_names=list(inputs),
            output_names=list(outputs),
            dynamic_axes={name: {0: "robots"} for name in (*inputs, *outputs)},
            opset_version=OPSET,
            dynamo=False,
        )
    return buffer.getvalue()
