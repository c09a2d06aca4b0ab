"""Who crosses a gap from memory, by the distance to its edge at the start.

`python benchmarks/starts.py STUDY` reads the folder of `renet evaluate memory` on one ground and
places its robots again. Tiles are squares whose gap begins 1.2 m from the middle.
"""

from __future__ import annotations

import sys
from itertools import pairwise, product
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from facts import errors_in_one_line
from renet.evaluation.evaluator import Evaluator
from renet.evaluation.results import read_results

EDGE = 1.2
"""Metres from the middle of a tile to its gap."""
BOUNDS = (0.0, 1.4, 2.0)
"""Distances between which robots are counted, m."""


def distances(position: np.ndarray, yaw: np.ndarray) -> np.ndarray:
    """How far each robot is from the edge, m, [N], straight ahead.

    Args:
        position: from the tile's middle, m, [N, 2]. yaw: radians, [N].
    """
    heading = np.stack((np.cos(yaw), np.sin(yaw)), axis=1)
    return ((EDGE * np.sign(heading) - position) / heading).min(axis=1)


def main(study: Path) -> None:
    """Print robots that crossed, of those that started so far away, for each group of robots."""
    settings = read_results(study / "summary.json")["settings"]
    (part,) = (study / "parts").glob("*.json")
    crossed = np.reshape(read_results(part)["crossed"], (-1, settings["robots"]))
    (ground,) = settings["grounds"]
    kind, _, level = ground.partition(":")
    evaluator = Evaluator(None, settings["engine"], settings["selector"])
    robots = range(settings["robots"])
    env = evaluator.make_env({kind: int(level)}, robots, settings["speed"], settings["seed"])
    env.place_on([kind] * len(robots))
    env.reset()
    poses = env.poses(robots)
    yaw = Rotation.from_quat(poses[:, 3:7], scalar_first=True).as_euler("ZYX")[:, 0]
    away = distances(poses[:, :2] - env.env.scene.env_origins[:, :2].numpy(), yaw)
    runs = product(settings["modes"], (0.0, *settings["without"]))
    for (mode, seconds), row in zip(runs, crossed, strict=True):
        for low, high in pairwise(BOUNDS):
            group = row[(away >= low) & (away < high)]
            print(f"{mode}, {seconds:g} s, {low:g} to {high:g} m: {group.sum()} of {len(group)}")


if __name__ == "__main__":
    with errors_in_one_line():
        main(Path(sys.argv[1]))
