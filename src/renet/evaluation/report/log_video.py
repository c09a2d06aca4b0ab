"""`renet play --log`: a recording of `renet deploy` as a film."""

from pathlib import Path

import mujoco
import numpy as np
from mjlab.entity import Entity

from renet.deploy.recording import Recording, read_recording
from renet.deploy.robots.mujoco import BASE, START_HEIGHT
from renet.deploy.robots.scene import scene_spec
from renet.deploy.score import fallen, track
from renet.errors import RenetError
from renet.evaluation.report.video import Panel, VideoCfg, make_video
from renet.evaluation.results import output_folder
from renet.faults import parse_fault
from renet.interface import CONTROL_DT, DEPTH_SHAPE, JOINTS
from renet.tasks.config.go1 import GO1


def film_log(log: Path, out: Path | None = None) -> Path:
    """Film a recording on the ground it was made on (a real robot's: flat); returns the mp4.

    Args:
        log: the recording.
        out: the film, an .mp4; beside the log by default.

    Raises:
        RenetError: not a recording, an empty one, or a scene file that is gone.
    """
    recording, look = read_recording(log), VideoCfg()
    if not len(recording.ticks):
        raise RenetError(f"{log} ends before its first control step: there is nothing to show")
    out = out or log.with_suffix(".mp4")
    output_folder(out.parent)
    frames = np.arange(0, len(recording.ticks), round(1 / (look.fps * CONTROL_DT)))
    header = recording.header
    simulated = header.get("robot") in ("mujoco", "pybullet")
    terrain = header["terrain"] if simulated else "flat"
    scene = Path(header["scene"]) if simulated and header["scene"] else None
    robot = Entity(GO1.entity()).spec  # With its visual meshes.
    spec, _ = scene_spec(terrain, header.get("level", 1), scene, header.get("seed", 0), robot)
    poses = _poses(recording, spec.compile())[frames]
    return make_video(out, spec, poses[:, None], [_panel(recording, frames)], look)


def _poses(recording: Recording, model: mujoco.MjModel) -> np.ndarray:
    """Generalised positions [T, nq] of a model with one robot in it."""
    ticks = recording.ticks
    base = track(ticks)
    if not np.isfinite(ticks["base_position"]).all():
        base = base + np.array((0.0, 0.0, START_HEIGHT))
    poses = np.tile(model.qpos0, (len(ticks), 1))
    free = model.jnt_qposadr[model.body(BASE).jntadr[0]]
    poses[:, free : free + 3] = base
    poses[:, free + 3 : free + 7] = _held(ticks["quaternion"], (1.0, 0.0, 0.0, 0.0))
    joints = [model.joint(name).qposadr[0] for name in JOINTS]
    poses[:, joints] = _held(ticks["joint_position"], model.qpos0[joints])
    return poses


def _held(values: np.ndarray, first) -> np.ndarray:
    """Rows [T, …] with those that are no reading replaced by the one before."""
    values = values.copy()
    for row, value in enumerate(values):
        if not np.isfinite(value).all() or not value.any():
            values[row] = values[row - 1] if row else first
    return values


def _panel(recording: Recording, frames: np.ndarray) -> Panel:
    ticks = recording.ticks
    images, shown = np.zeros((len(ticks), *DEPTH_SHAPE), np.uint8), np.zeros(DEPTH_SHAPE, np.uint8)
    for row in range(len(ticks)):
        if row in recording.images:
            clean = np.nan_to_num(recording.images[row].astype(np.float32), posinf=1.0)
            shown = (255 * np.clip(clean, 0.0, 1.0)).astype(np.uint8)
        images[row] = shown
    faults = [parse_fault(text) for text in recording.header.get("fault", [])]
    steps = np.round((ticks["now"][frames] - ticks["now"][0]) / CONTROL_DT).astype(int).tolist()
    velocity = np.where(ticks["vision"][:, None], ticks["velocity_vp"], ticks["velocity_op"])
    return Panel(
        title=str(recording.header.get("bundle", "recording")),
        depth=images[frames],
        vision=ticks["vision"][frames],
        has_image=ticks["has_image"][frames],
        fallen=fallen(ticks)[frames],
        fault=[", ".join(f.fault for f in faults if f.at_work(step)) for step in steps],
        speed=velocity[frames, 0],
    )
