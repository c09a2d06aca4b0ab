"""`renet export`: trained networks become a bundle of ONNX models (paper, Experimental Setup)."""

import io
import warnings
from collections.abc import Iterable
from datetime import date
from pathlib import Path
from typing import Any

import torch
from mjlab.entity import Entity
from mjlab.utils.string import resolve_expr
from safetensors import SafetensorError
from torch import Tensor, nn

from renet import __version__
from renet.bundle import write_bundle
from renet.bundle.manifest import CameraSpec, Manifest, ProvenanceSpec, RobotSpec, from_json
from renet.bundle.models import HAS_IMAGE, MAP_ERROR, VARIANCE, model_shapes
from renet.errors import RenetError
from renet.interface import (
    HEADING_PROPRIOCEPTION,
    HEIGHT_MAP_SIZE,
    JOINTS,
    NUM_FEET,
    PROPRIOCEPTION,
)
from renet.models.adaptation import fuse
from renet.models.autoencoder import anomaly_score, variance_score
from renet.models.config import ModelCfg
from renet.models.renet import RENet
from renet.options import ExportCfg
from renet.selector import SelectorSpec
from renet.sim.depth.camera import DepthCameraCfg, DepthNoiseCfg
from renet.tasks import env_cfg
from renet.tasks.config.go1 import GO1
from renet.tasks.mdp.commands import COMMAND
from renet.tasks.robot_cfg import ACTION_CLIP, RobotCfg
from renet.training import checkpoint as checkpoints
from renet.training.config import WithholdingCfg, from_dict

OPSET = 17
"""Old enough for the ONNX Runtime of a robot's computer, new enough for LayerNormalization."""


def export(cfg: ExportCfg) -> Path:
    """Export and return the bundle's folder; raises RenetError for a foreign checkpoint."""
    path = checkpoints.find(cfg.checkpoint)
    model, state = load_networks(path), checkpoints.load_state(path)
    try:
        provenance = _provenance(state, model.cfg)
        sensors = state["env"].get("scene", {}).get("sensors", [])
        noise_std = [sensor["noise"]["gaussian_std"] for sensor in sensors if "noise" in sensor]
        learned = from_dict(WithholdingCfg, state["agent"].get("withholding", {}))
        goals = state["env"].get("commands", {}).get(COMMAND, {})
        twist = goals.get("told") == "twist"
    except (KeyError, TypeError, AttributeError) as error:
        raise RenetError(f"{path} is not a checkpoint of RENet: its state lacks {error}") from error
    robot = env_cfg(provenance.task).robot if provenance.task else GO1
    selector = SelectorSpec(
        beta=cfg.beta,
        calibration="none: run `renet calibrate`",
        longest_memory=learned.longest if learned.share else 0.0,
    )
    camera = camera_spec(robot, *noise_std[:1])
    manifest = Manifest(
        robot_spec(robot),
        camera,
        selector,
        provenance,
        model.cfg.history,
        model.cfg.frames,
        PROPRIOCEPTION if twist else HEADING_PROPRIOCEPTION,
    )
    return write_bundle(cfg.out, export_models(model), manifest)


def load_networks(path: Path) -> RENet:
    """Rebuild the networks a checkpoint was taken from.

    Raises:
        RenetError: a file is missing or damaged, or weights and settings do not fit each other.
    """
    try:
        cfg = from_dict(ModelCfg, checkpoints.load_state(path)["agent"]["model"])
        weights = checkpoints.header(path / "model.safetensors")
        critic_size = weights["critic_normalizer._mean"].shape[-1]
        with torch.device("meta"):  # Takes no memory, whatever sizes a stranger wrote.
            shapes = RENet(cfg, critic_size)
    except KeyError as error:
        raise RenetError(f"{path} is not a checkpoint of RENet: it lacks {error}") from error
    except SafetensorError as error:
        raise RenetError(f"checkpoint {path} is incomplete or damaged: {error}") from error
    except (TypeError, ValueError, RuntimeError, OverflowError, AttributeError) as error:
        raise RenetError(f"{path}: the model's settings make no sense: {error}") from error
    checkpoint = checkpoints.load(path, model=shapes)
    model = RENet(cfg, critic_size)
    checkpoints.load_model(model, checkpoint.exported, path)
    return model.eval()


def robot_spec(robot: RobotCfg = GO1) -> RobotSpec:
    """A robot as the tasks drive it, read from the model they compile."""
    cfg = robot.entity()
    model = Entity(cfg).spec.compile()
    default = resolve_expr(cfg.init_state.joint_pos or {}, JOINTS)
    limits = [model.joint(name).range for name in JOINTS]
    return RobotSpec(
        name=robot.name,
        joints=JOINTS,
        default_position=tuple(float(value) for value in default),
        stiffness=(robot.stiffness,) * len(JOINTS),
        damping=(robot.damping,) * len(JOINTS),
        torque_limit=tuple(float(robot.motor(name).torque) for name in JOINTS),
        lower=tuple(float(low) for low, _ in limits),
        upper=tuple(float(high) for _, high in limits),
        action_scale=robot.action_scale,
        action_clip=ACTION_CLIP,
    )


def camera_spec(robot: RobotCfg = GO1, noise_std: float = DepthNoiseCfg.gaussian_std) -> CameraSpec:
    """The tasks' camera on a robot; `noise_std` is of the constant part of the depth error, m."""
    camera = DepthCameraCfg(name="depth_camera", mount=robot.camera)
    return CameraSpec(
        **vars(camera.intrinsics),
        range=camera.range,
        position=camera.mount.position,
        pitch=camera.mount.pitch,
        rate_hz=1.0 / camera.period,
        noise_std=noise_std,
    )


def _provenance(state: dict[str, Any], cfg: ModelCfg) -> ProvenanceSpec:
    fields = {
        "task": state["task"] or "",
        "iteration": state["iteration"],
        "steps": state["steps"],
        "seconds": round(state["seconds"], 1),
        "seed": state["agent"].get("seed", 0),
        "perception": cfg.perception,
        "encoder": cfg.encoder,
        "date": date.today().isoformat(),
        "renet": __version__,
    }
    return from_json(ProvenanceSpec, fields, "checkpoint")


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
        self,
        history: Tensor,
        depth: Tensor,
        latent_op: Tensor,
        latent_vp: Tensor,
        has_image: Tensor,
    ) -> tuple[Tensor, ...]:
        """Next latents and predictions; a head absent from an ablation predicts zeros."""
        next_op = self.op(history, depth, has_image, latent_op)
        next_vp = self.vp(history, depth, has_image, latent_vp)
        op, vp = self.op.predict(next_op), self.vp.predict(next_vp)
        outputs = [next_op, next_vp]
        for heads, name, size in (
            (op, "velocity", 3),
            (vp, "velocity", 3),
            (vp, "feet_height", NUM_FEET),
            (vp, "height_map", HEIGHT_MAP_SIZE),
        ):
            outputs.append(heads.get(name, next_vp[:, :1] * torch.zeros(size)))
        if self.vp.map_error_head is not None:
            outputs.append(self.vp.map_error(next_vp))
        return tuple(outputs)


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
    """The three ONNX models by name, with a batch axis; raises RenetError for an Oracle."""
    if model.cfg.perception == "oracle":
        raise RenetError("the Oracle reads the simulator's truth and cannot be exported")
    model, shapes = model.cpu().eval(), model_shapes(model.cfg.history)
    shapes["estimator"][0][HAS_IMAGE] = (1,)
    if model.cfg.detector == "variance":
        shapes["vision"][1][VARIANCE] = ()
    if model.vp.map_error_head is not None:
        shapes["estimator"][1][MAP_ERROR] = ()
    graphs = {"actor": ActorGraph, "estimator": EstimatorGraph, "vision": VisionGraph}
    return {name: _to_onnx(graph(model), *shapes[name]) for name, graph in graphs.items()}


def _to_onnx(graph: nn.Module, inputs: dict[str, tuple[int, ...]], outputs: Iterable[str]) -> bytes:
    """Serialise a graph, given inputs' shapes and outputs' names; all have the batch first."""
    buffer, example = io.BytesIO(), tuple(torch.zeros(2, *shape) for shape in inputs.values())
    # The tracing exporter is deprecated but keeps these small graphs free of external data.
    with warnings.catch_warnings(action="ignore"):
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
