"""Make the moving picture of the driven robot: `python tools/drive_film.py [BUNDLE]`.

Robots on flat ground are told to walk backward, to the left, and to turn on the spot. It writes
docs/figures/drive.webp.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np

from animated_webp import write_webp
from renet.evaluation.evaluator import Evaluator
from renet.evaluation.rollout import Trial
from renet.evaluation.settings import FLAT_GROUND
from renet.evaluation.video import film, pictures
from renet.interface import control_steps

OUT = Path(__file__).parents[1] / "docs" / "figures" / "drive.webp"
COMMANDS = {
    "told: back 0.6 m/s": (-0.6, 0.0, 0.0),
    "told: left 0.4 m/s": (0.0, 0.4, 0.0),
    "told: turn 1 rad/s": (0.0, 0.0, 1.0),
}
"""Velocities ahead and to the left, m/s, and turn rates, rad/s, by the titles of their robots."""
SECONDS = 5.0
PICTURE_STEPS = 2
"""Control steps from one picture of the film to the next."""


def main() -> None:
    """Drive, film, and write an animated WebP."""
    bundle = Path(sys.argv[1] if len(sys.argv) > 1 else "go1-driven")
    evaluator = Evaluator(bundle, conditions="nominal")
    rows = range(len(COMMANDS))
    env = evaluator.make_env(FLAT_GROUND, [0] * len(rows), speed=0.6, seed=0)
    env.follow(np.array(list(COMMANDS.values())))
    rollout = evaluator.rollout(env, [Trial("camera")] * len(rows), seed=0)
    steps = control_steps(SECONDS)
    trace = rollout.run(steps, "robots are driven", film=rows)
    titles = dict(enumerate(COMMANDS))
    with tempfile.TemporaryDirectory() as folder:
        shown = range(0, steps, PICTURE_STEPS)
        frames = pictures(env.scene_spec, trace, titles, "", shown)
        path = film(Path(folder) / "film.mp4", frames)
        write_webp(path, OUT, quality=40, width=840)


if __name__ == "__main__":
    main()
