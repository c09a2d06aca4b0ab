"""Export of trained networks to a bundle of ONNX models (paper, Experimental Setup)."""

import io
import warnings
from collections.abc import Iterable, Iterator
from datetime import date
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from torch import Tensor, nn

from renet import __version__
from renet.bundle import write_bundle
from renet.bundle.manifest import CameraSpec, Manifest, ProvenanceSpec, RobotSpec
from renet.bundle.models import (
    EVIDENCE,
    HAS_IMAGE,
    MAP_ERROR,
    NEXT_EVIDENCE,
    STILLNESS,
    SURPRISE,
    VARIANCE,
    model_shapes,
    recollection_shapes,
)
from renet.conversion import from_json
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
from renet.models.expectation import Evidence, Recollection, mean_blocks
from renet.models.renet import RENet
from renet.options import ExportCfg
from renet.robots import GO1, Robot
from renet.selector import SelectorSpec
from renet.sim.depth.camera import DepthCameraCfg, DepthNoiseCfg
from renet.tasks import stored_env_cfg
from renet.tasks.entity import ACTION_CLIP
from renet.tasks.mdp.commands import COMMAND
from renet.training import checkpoint as checkpoints
from renet.training.config import WithholdingCfg, from_dict
from renet.training.provenance import by_name, to_json

OPSET = 17
"""Version of ONNX's operators: old enough for the ONNX Runtime of a robot's computer, new enough
for LayerNormalization."""
DESCRIBED = {
    "damping",
    "effort_limit",
    "intrinsics",
    "period",
    "pitch",
    "position",
    "range",
    "scale",
    "stiffness",
}
"""Settings of actions, actuators and camera that a manifest repeats."""


def export(cfg: ExportCfg) -> Path:
    """Export a checkpoint and return the bundle's folder.

    Raises:
        RenetError: The folder is no checkpoint of RENet, or one of a changed robot or camera, or of
            a task that is not registered here.
    """
    path = checkpoints.find(cfg.checkpoint)
    model = load_networks(path)
    state = checkpoints.load_state(path)
    try:
        provenance = _provenance(state, model.cfg)
        sensors = state["env"].get("scene", {}).get("sensors", [])
        noise_std = [sensor["noise"]["gaussian_std"] for sensor in sensors if "noise" in sensor]
        withholding = from_dict(WithholdingCfg, state["agent"].get("withholding", {}))
        goals = state["env"].get("commands", {}).get(COMMAND, {})
        twist = goals.get("told") == "twist"
    except (KeyError, TypeError, AttributeError) as error:
        raise RenetError(f"{path} is not a checkpoint of RENet: its state lacks {error}") from error
    robot = GO1
    if provenance.task:
        task = stored_env_cfg(provenance.task)
        robot = task.robot
        _check_described(to_json(task), state["env"], path)
    selector = SelectorSpec(
        beta=cfg.beta,
        calibration="none: run `renet calibrate`",
        # A policy remembers no longer than it had to in training.
        longest_memory=withholding.longest if withholding.share else 0.0,
    )
    # Without a noisy camera in the task, the noise is the default one.
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


def _check_described(task: dict[str, Any], trained: dict[str, Any], path: Path) -> None:
    """Check that the manifest, which describes the task's robot and camera, holds for a checkpoint.

    Args:
        task: Settings of the registered task, as JSON.
        trained: Settings with which the checkpoint was trained, as JSON.
        path: The checkpoint.

    Raises:
        RenetError: It was trained with other gains, another scale of actions or another camera.
    """
    described = dict(_described(task))
    for name, value in _described(trained):
        if described.get(name, value) != value:
            raise RenetError(
                f"{path} was trained with {name} {value}; its task has {described[name]}, which a "
                "bundle would tell the robot: register the changed robot as a task of its own, as "
                "examples/add_robot.py does, and train that"
            )


def _described(env: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield names and values of a task's settings, as JSON, that a manifest repeats."""
    scene = env.get("scene", {})
    parts = {"actions": env.get("actions")}
    parts["robot"] = scene.get("entities", {}).get("robot", {}).get("articulation")
    for sensor in scene.get("sensors", []):
        if "mount" in sensor:
            parts[sensor["name"]] = sensor
    yield from _leaves(parts, "")


def _leaves(value: Any, name: str) -> Iterator[tuple[str, Any]]:
    """Yield names, with dots between levels, and values of the settings `DESCRIBED`."""
    value = by_name(value)
    if not isinstance(value, dict):
        return
    for key, item in value.items():
        inner = f"{name}.{key}" if name else key
        if key in DESCRIBED:
            yield inner, item
        else:
            yield from _leaves(item, inner)


def load_networks(path: Path) -> RENet:
    """Build the networks of a checkpoint, with its weights.

    Raises:
        RenetError: A file is missing or damaged, or weights and settings do not fit each other.
    """
    try:
        cfg = from_dict(ModelCfg, checkpoints.load_state(path)["agent"]["model"])
        weights = checkpoints.header(path / "model.safetensors")
        critic_size = weights["critic_normalizer._mean"].shape[-1]
        # On the device meta, so that no sizes, which a stranger may have written, take memory.
        with torch.device("meta"):
            shapes = RENet(cfg, critic_size)
    except KeyError as error:
        raise RenetError(f"{path} is not a checkpoint of RENet: it lacks {error}") from error
    except SafetensorError as error:
        raise RenetError(f"checkpoint {path} is incomplete or damaged: {error}") from error
    except (TypeError, ValueError, RuntimeError, OverflowError, AttributeError) as error:
        raise RenetError(f"{path}: the model's settings make no sense: {error}") from error
    checkpoint = checkpoints.load_checkpoint(path, model=shapes)
    model = RENet(cfg, critic_size)
    checkpoints.load_model(model, checkpoint.exported, path)
    return model.eval()


def robot_spec(robot: Robot = GO1) -> RobotSpec:
    """Write what a bundle says of a robot's joints."""
    return RobotSpec(
        name=robot.name,
        joints=JOINTS,
        default_position=tuple(robot.default_position.tolist()),
        stiffness=(robot.stiffness,) * len(JOINTS),
        damping=(robot.damping,) * len(JOINTS),
        torque_limit=tuple(robot.torque.tolist()),
        lower=tuple(robot.lower.tolist()),
        upper=tuple(robot.upper.tolist()),
        action_scale=robot.action_scale,
        action_clip=ACTION_CLIP,
    )


def camera_spec(robot: Robot = GO1, noise_std: float = DepthNoiseCfg.gaussian_std) -> CameraSpec:
    """Describe the tasks' camera on a robot.

    Args:
        robot: The robot.
        noise_std: Standard deviation of the constant part of the depth error, m.
    """
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
    """Describe the run of a checkpoint, given its state and the model's configuration."""
    fields = {
        "task": state["task"],
        "iteration": state["iteration"],
        "steps": state["steps"],
        "seconds": round(state["seconds"], 1),
        "seed": state["agent"].get("seed", 0),
        "perception": cfg.perception,
        "encoder": cfg.encoder,
        "date": date.today().isoformat(),
        "renet": __version__,
    }
    return from_json(ProvenanceSpec, fields, "the checkpoint's state", "train anew")


class ActorGraph(nn.Module):
    """Graph that runs at 50 Hz: from o_t, both latents and the paper's mask to an action."""

    def __init__(self, model: RENet) -> None:
        super().__init__()
        self.actor = model.actor

    def forward(
        self, proprioception: Tensor, latent_op: Tensor, latent_vp: Tensor, op_mask: Tensor
    ) -> Tensor:
        """Compute the mean action, [N, 12]."""
        return self.actor(proprioception, fuse(latent_op, latent_vp, op_mask))


class EstimatorGraph(nn.Module):
    """Graph that runs at 10 Hz: both estimators, from memory to memory and predictions."""

    def __init__(self, model: RENet) -> None:
        super().__init__()
        self.op = model.op
        self.vp = model.vp

    def forward(
        self,
        history: Tensor,
        depth: Tensor,
        latent_op: Tensor,
        latent_vp: Tensor,
        has_image: Tensor,
    ) -> tuple[Tensor, ...]:
        """Compute next latents and predictions; a head that an ablation lacks predicts zeros."""
        next_op = self.op(history, depth, has_image, latent_op)
        next_vp = self.vp(history, depth, has_image, latent_vp)
        op_predictions = self.op.predict(next_op)
        vp_predictions = self.vp.predict(next_vp)
        outputs = [next_op, next_vp]
        for predictions, name, size in (
            (op_predictions, "velocity", 3),
            (vp_predictions, "velocity", 3),
            (vp_predictions, "feet_height", NUM_FEET),
            (vp_predictions, "height_map", HEIGHT_MAP_SIZE),
        ):
            # From an input, so that the graph's batch axis has the input's size.
            zeros = next_vp[:, :1] * torch.zeros(size)
            outputs.append(predictions.get(name, zeros))
        if self.vp.map_error_head is not None:
            outputs.append(self.vp.map_error(next_vp))
        return tuple(outputs)


class VisionGraph(nn.Module):
    """Graph that runs at 10 Hz: the autoencoder, the expectation, and their scores."""

    def __init__(self, model: RENet) -> None:
        super().__init__()
        self.autoencoder = model.autoencoder
        self.expectation = model.expectation

    def forward(self, depth: Tensor, *known: Tensor) -> tuple[Tensor, ...]:
        """Compute the reconstruction [N, 2, 48, 64], Loss_ad [N], and other scores, [N] each.

        The variance score is an output of the variance detector alone. Models with an expectation
        also take `bundle.models.recollection_shapes` and `EVIDENCE`, and give the surprise, the
        stillness and the next evidence.
        """
        reconstruction, log_variance = self.autoencoder.predict(depth)
        outputs = [reconstruction, anomaly_score(depth, reconstruction)]
        if log_variance is not None:
            outputs.append(variance_score(depth, reconstruction, log_variance))
        if self.expectation is not None:
            history, latent, last_image, age, evidence = known
            recollection = Recollection(latent, history, mean_blocks(last_image), age[:, 0])
            blocks = mean_blocks(depth[:, 0])
            before = Evidence(evidence[:, 0], evidence[:, 1])
            after = self.expectation.weigh(recollection, blocks, before)
            outputs.append(self.expectation.surprise(recollection, blocks))
            outputs += [after.stillness, torch.stack(after, dim=-1)]
        return tuple(outputs)


def export_models(model: RENet) -> dict[str, bytes]:
    """Export the three ONNX models by name, with a batch axis.

    Raises:
        RenetError: The model is an Oracle, which reads the simulator's true state.
    """
    if model.cfg.perception == "oracle":
        raise RenetError("the Oracle reads the simulator's truth and cannot be exported")
    model = model.cpu().eval()
    shapes = model_shapes(model.cfg.history)
    # Inputs and outputs that older bundles lack.
    shapes["estimator"][0][HAS_IMAGE] = (1,)
    if model.cfg.detector == "variance":
        shapes["vision"][1][VARIANCE] = ()
    if model.expectation is not None:
        inputs, outputs = shapes["vision"]
        inputs.update(recollection_shapes(model.cfg.history) | EVIDENCE)
        outputs.update({SURPRISE: (), STILLNESS: ()} | NEXT_EVIDENCE)
    if model.vp.map_error_head is not None:
        shapes["estimator"][1][MAP_ERROR] = ()
    graphs = {"actor": ActorGraph, "estimator": EstimatorGraph, "vision": VisionGraph}
    return {name: _to_onnx(graph(model), *shapes[name]) for name, graph in graphs.items()}


def _to_onnx(graph: nn.Module, inputs: dict[str, tuple[int, ...]], outputs: Iterable[str]) -> bytes:
    """Serialize a graph.

    Args:
        graph: Module whose `forward` takes the inputs in order.
        inputs: Shapes of the inputs by name, without the batch axis, which is the first.
        outputs: Names of the outputs, which have a batch axis, too.
    """
    buffer = io.BytesIO()
    example = tuple(torch.zeros(2, *shape) for shape in inputs.values())
    # The tracing exporter is deprecated, but keeps these small graphs free of external data.
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
