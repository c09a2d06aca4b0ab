"""`renet export`: a checkpoint becomes a bundle."""

from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

import torch
import tyro
from mjlab.entity import Entity
from mjlab.utils.string import resolve_expr

from renet import __version__
from renet.deploy.bundle import write_bundle
from renet.deploy.bundle.manifest import CameraSpec, Manifest, Provenance, RobotSpec, from_json
from renet.errors import RenetError
from renet.interface import JOINTS
from renet.models.config import ModelCfg
from renet.models.renet import RENet
from renet.selector import SelectorSpec
from renet.sim.depth.camera import DepthCameraCfg
from renet.sim.depth.noise import DepthNoiseCfg
from renet.tasks import env_cfg
from renet.tasks.config.go1 import GO1
from renet.tasks.robot_cfg import ACTION_CLIP, RobotCfg
from renet.training import checkpoint as checkpoints
from renet.training.checkpoint import Checkpoint
from renet.training.config import from_dict
from renet.training.export import export_models


@dataclass(kw_only=True)
class ExportCfg:
    """Turn a checkpoint into a bundle: three ONNX models and a manifest."""

    checkpoint: tyro.conf.Positional[Path]
    """Checkpoint folder, or a run folder whose newest checkpoint is taken."""
    out: Path = Path("bundle")
    """Folder of the bundle; replaced if it already is one."""
    beta: float = 0.01
    """Selector threshold until `renet calibrate` measures one."""


def export(cfg: ExportCfg) -> Path:
    """Export and return the bundle's folder; raises RenetError for a foreign checkpoint."""
    if not cfg.checkpoint.exists():
        raise RenetError(f"no checkpoint at {cfg.checkpoint}")
    found = checkpoints.find(cfg.checkpoint)
    loaded = checkpoints.load(found)
    model = load_networks(loaded, found)
    try:
        provenance = _provenance(loaded.state, model.cfg)
        # Checkpoints that do not say were trained with the default.
        noise_std = loaded.state["config"].get("depth_noise_std", DepthNoiseCfg.gaussian_std)
    except (KeyError, TypeError, AttributeError) as error:
        raise RenetError(
            f"{found} is not a checkpoint of RENet: its state lacks {error}"
        ) from error
    robot = env_cfg(provenance.task).robot if provenance.task else GO1
    manifest = Manifest(
        robot=robot_spec(robot),
        camera=camera_spec(robot, noise_std),
        selector=SelectorSpec(beta=cfg.beta, calibration="none: run `renet calibrate`"),
        provenance=provenance,
        history=model.cfg.history,
        frames=model.cfg.frames,
    )
    return write_bundle(cfg.out, export_models(model), manifest)


def load_networks(checkpoint: Checkpoint, path: Path) -> RENet:
    """Rebuild the networks a checkpoint was taken from."""
    try:
        cfg = from_dict(ModelCfg, checkpoint.state["config"]["model"])
        critic_size = checkpoint.model["critic_normalizer._mean"].shape[-1]
        with torch.device("meta"):  # Takes no memory, whatever sizes a stranger wrote.
            shapes = RENet(cfg, critic_size).state_dict()
    except KeyError as error:
        raise RenetError(f"{path} is not a checkpoint of RENet: it lacks {error}") from error
    except (TypeError, ValueError, RuntimeError, OverflowError, AttributeError) as error:
        raise RenetError(f"{path}: the model's settings make no sense: {error}") from error
    checkpoints.check_same_architecture(shapes, checkpoint.model, path)
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
    """The tasks' camera.

    Args:
        robot: that carries it.
        noise_std: of the constant part of the depth error, m.
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


def _provenance(state: dict[str, Any], cfg: ModelCfg) -> Provenance:
    found = {
        "task": state["task"] or "",
        "iteration": state["iteration"],
        "steps": state["steps"],
        "seconds": round(state["seconds"], 1),
        "seed": state["config"].get("seed", 0),
        "perception": cfg.perception,
        "encoder": cfg.encoder,
        "date": date.today().isoformat(),
        "renet": __version__,
    }
    return from_json(Provenance, found, "checkpoint")
