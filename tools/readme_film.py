"""Make the README's moving picture: `python tools/readme_film.py` writes docs/figures/walk.webp.

Of 20 pairs with the same start on the same stairs and the same noise, it shows the pair whose robot
with vision alone is the first to fall.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from pathlib import Path

import imageio_ffmpeg

from renet.evaluation.demo import film_comparison
from renet.evaluation.studies.benchmark import Setting
from renet.evaluation.studies.noise import NoiseStudy

OUT = Path(__file__).parents[1] / "docs" / "figures" / "walk.webp"
NOISE = Setting("stairs_up", 1.5, "gaussian", 5)
LEVEL = 5
"""Stairs with risers of 13 cm."""
FPS = 10


def main() -> None:
    """Film, and write an animated WebP."""
    onset = (NOISE.onset,)
    study = NoiseStudy(grounds=(NOISE.ground,), level=LEVEL, onsets=onset, seconds=7.5)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "film.mp4"
        film_comparison(study, study.make_evaluator(), NOISE, path, FPS)
        ffmpeg = shutil.which("ffmpeg") or imageio_ffmpeg.get_ffmpeg_exe()
        webp = ["-c:v", "libwebp_anim", "-quality", "40", "-loop", "0", str(OUT)]
        subprocess.run([ffmpeg, "-v", "error", "-y", "-i", str(path), *webp], check=True)
    print(f"{OUT}: {OUT.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
