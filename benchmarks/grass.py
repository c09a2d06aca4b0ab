"""What tells dense from sparse grass: scores of images of several grounds behind blades.

Usage: python -m benchmarks.grass [BUNDLE] [--runs 10]

A camera is carried over each ground as the walking robot's trunk is, without a policy. Printed are
the smallest and the largest value of a run: of each image alone the run's maximum, and of holes the
mean over one second.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import mujoco
import numpy as np
import onnxruntime
from benchmarks.facts import errors_in_one_line

from renet.bundle import Bundle
from renet.deploy.cameras.sim import SimCamera
from renet.deploy.robots.sim.mujoco import MujocoRobot
from renet.deploy.robots.sim.scene import build_scene
from renet.faults import FAULTS, Frames

GROUNDS = ("flat", "stairs_up", "stairs_down", "obstacles", "platform", "gap")
SETTINGS = (("healthy", 0), *(("tall_grass", severity) for severity in range(1, 6)))
TICKS, SECOND = 20, 10
"""Images of a run, and of a second."""
STEP, HEIGHT = 0.06, 0.29
"""m between images at 0.6 m/s; of the trunk above the ground."""
SWAY = (0.02, 0.03)
"""rad of roll and pitch, standard deviation."""


def carry(bundle: Bundle, ground: str, run: int) -> np.ndarray:
    """Images [ticks, 48, 64] of a camera that is carried over a ground, with training's noise."""
    model, height = build_scene(ground, 1 if ground == "flat" else 3)
    robot = MujocoRobot(model, bundle.manifest.robot, height)
    camera = SimCamera(robot, bundle.manifest.camera, seed=run)
    rng = np.random.default_rng([run, GROUNDS.index(ground)])
    x, y, yaw = rng.uniform(-0.3, 1.5), *rng.uniform(-0.3, 0.3, 2)
    images, down, hit = [], np.array([0.0, 0.0, -1.0]), np.zeros(1, np.int32)
    terrain = np.array([1, 0, 0, 0, 0, 0], np.uint8)
    for tick in range(TICKS):
        above = np.array([x + STEP * tick, y, 3.0])
        z = 3.0 - mujoco.mj_ray(model, robot.data, above, down, terrain, 1, -1, hit)
        robot.data.qpos[:3] = *above[:2], z + HEIGHT
        turn = np.array([*rng.normal(0.0, SWAY), yaw])
        mujoco.mju_euler2Quat(robot.data.qpos[3:7], turn, "xyz")
        mujoco.mj_kinematics(model, robot.data)
        robot.data.time = 0.1 * tick
        images.append(camera.latest().image)
    return np.array(images)


def scores(vision: onnxruntime.InferenceSession, images: np.ndarray) -> dict[str, float]:
    """Largest anomaly and variance score of the pairs of a run's images [ticks, 48, 64]."""
    names = [output.name for output in vision.get_outputs()]
    pairs = zip(images[1:], images, strict=False)
    seen = [
        dict(zip(names, vision.run(None, {"depth": np.stack(pair)[None]}), strict=True))
        for pair in pairs
    ]
    scores = [name for name in ("anomaly_score", "variance_score") if name in names]
    return {name: max(float(np.ravel(one[name])[0]) for one in seen) for name in scores}


def main() -> None:
    """Print one line for each density."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("bundle", type=Path, nargs="?")
    parser.add_argument("--runs", type=int, default=10)
    args = parser.parse_args()
    bundle = Bundle.load(args.bundle)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    vision = onnxruntime.InferenceSession(str(bundle.path / "vision.onnx"), options)
    runs = [carry(bundle, ground, run) for ground in GROUNDS for run in range(args.runs)]
    for name, severity in SETTINGS:
        rows = []
        for number, images in enumerate(runs):
            holes = np.zeros(TICKS)
            if severity:
                rngs = [np.random.default_rng([severity, number])]
                fault = FAULTS[name](FAULTS[name].level_of(severity), rngs)
                spoilt = [fault.corrupt(Frames.healthy(i[None]), np.zeros(1)) for i in images]
                images = np.concatenate([one.image for one in spoilt])
                holes = np.array([one.invalid[0] for one in spoilt])
            mean = np.convolve(holes, np.full(SECOND, 1 / SECOND), "valid").max()
            rows.append({"holes": holes.max(), "mean": mean, **scores(vision, images)})
        said = [
            f"{key} {min(r[key] for r in rows):.3f} to {max(r[key] for r in rows):.3f}"
            for key in rows[0]
        ]
        print(f"{name}:{severity} {len(rows)} runs: " + ", ".join(said), flush=True)


if __name__ == "__main__":
    with errors_in_one_line():
        main()
