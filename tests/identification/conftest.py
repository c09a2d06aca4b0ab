"""A log of a robot with other motors, simulated by code of its own."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from renet.interface import JOINTS
from renet.robots import GO2

KP, KD = 20.0, 0.5
MOTORS = {
    "hip": {"armature": 0.012, "damping": 0.10, "friction": 0.30, "delay": 0.004},
    "thigh": {"armature": 0.022, "damping": 0.30, "friction": 0.15, "delay": 0.007},
    "calf": {"armature": 0.040, "damping": 0.20, "friction": 0.60, "delay": 0.010},
}
"""What the log is made with: none of these is the description's."""
STEP = 0.0005
ROW = 10
"""Steps of a row: 200 Hz."""
TARGET_ROWS = 4
"""Rows for which a target stays: 50 Hz, as a policy gives them."""


def wander(rows: int) -> np.ndarray:
    """Targets [rows, 12] within the joints' limits: a sum of sines of each joint's own."""
    rng = np.random.default_rng(5)
    rate = rng.uniform(0.4, 3.0, (12, 4))
    phase = rng.uniform(0.0, 2.0 * np.pi, (12, 4))
    time = np.arange(rows)[:, None, None] // TARGET_ROWS * TARGET_ROWS * ROW * STEP
    sines = np.sin(2.0 * np.pi * rate * time + phase).mean(axis=2)
    return np.tile([0.0, 0.8, -1.7], 4) + np.tile([0.6, 0.8, 0.7], 4) * sines


def simulate(rows: int) -> dict[str, np.ndarray]:
    """Targets, positions and velocities [rows, 12] of a Go2 that hangs, with motors of `MOTORS`.

    Its servos are torques that this function computes at 2 kHz from targets in a queue; the code
    that is tested leaves servos and delays to MuJoCo's own and to a mean over each step.
    """
    spec = mujoco.MjSpec.from_file(str(GO2.mjcf))
    spec.delete(spec.joint("floating_base_joint"))
    for servo in list(spec.actuators):
        spec.delete(servo)
    for geom in spec.geoms:
        geom.contype = geom.conaffinity = 0
    for name in JOINTS:
        motor = MOTORS[name.split("_")[1]]
        spec.joint(name).armature = motor["armature"]
        spec.joint(name).damping[0] = motor["damping"]
        spec.joint(name).frictionloss = motor["friction"]
    spec.option.timestep = STEP
    model = spec.compile()
    data = mujoco.MjData(model)
    place = [model.joint(name).qposadr[0] for name in JOINTS]
    dof = [model.joint(name).dofadr[0] for name in JOINTS]
    late = np.array([MOTORS[name.split("_")[1]]["delay"] for name in JOINTS])
    late = np.round(late / STEP).astype(int)
    target = wander(rows)
    sent = np.repeat(target, ROW, axis=0)
    data.qpos[place] = target[0]
    log = {"target": target, "position": [], "velocity": []}
    for step in range(rows * ROW):
        if step % ROW == 0:
            log["position"].append(data.qpos[place].copy())
            log["velocity"].append(data.qvel[dof].copy())
        goal = sent[np.maximum(step - late, 0), np.arange(12)]
        data.qfrc_applied[dof] = KP * (goal - data.qpos[place]) - KD * data.qvel[dof]
        mujoco.mj_step(model, data)
    return {name: np.array(values) for name, values in log.items()}


@pytest.fixture(scope="session")
def motion() -> dict[str, np.ndarray]:
    """Eight seconds of a hanging Go2, [1600, 12] by quantity."""
    return simulate(1600)


def write_csv(path: Path, columns: dict[str, np.ndarray]) -> Path:
    """A CSV file of columns [T] by name."""
    header = ",".join(columns)
    np.savetxt(path, np.stack([*columns.values()], 1), "%.13g", ",", header=header, comments="")
    return path


def named(motion: dict[str, np.ndarray], rows: int | None = None) -> dict[str, np.ndarray]:
    """Columns as `renet identify` names them by default."""
    columns = {"time": 3.0 + np.arange(len(motion["target"]))[:rows] * ROW * STEP}
    for quantity, values in motion.items():
        for number, joint in enumerate(JOINTS):
            columns[f"{joint}_{quantity}"] = values[:rows, number].copy()
    count = len(columns["time"])
    return columns | {"kp": np.full(count, KP), "kd": np.full(count, KD)}
