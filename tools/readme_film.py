"""Make the README's moving picture: `python tools/readme_film.py` writes docs/figures/walk.webp.

It is the film of `renet demo`: of 20 pairs with the same start and the same noise, the pair whose
robot with vision alone is the first to fall.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import mediapy
from PIL import Image

from renet.evaluation.demo import film_comparison
from renet.evaluation.report.video import VideoCfg
from renet.evaluation.studies.noise import NoiseStudy

OUT = Path(__file__).parents[1] / "docs" / "figures" / "walk.webp"
NOISE = ("salt_and_pepper", 3)
FPS = 10


def main() -> None:
    """Film, and write an animated WebP."""
    study = NoiseStudy()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "film.mp4"
        film_comparison(study, study.make_evaluator(), NOISE, path, VideoCfg(fps=FPS))
        frames = [Image.fromarray(image) for image in mediapy.read_video(path)]
    frames[0].save(
        OUT, save_all=True, append_images=frames[1:], duration=1000 // FPS, loop=0, quality=60
    )
    print(f"{OUT}: {len(frames)} frames, {OUT.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
