"""Make the README's moving picture: `python tools/readme_film.py` writes docs/figures/walk.webp.

It is the film of `renet demo`: of 20 pairs with the same start and the same noise, the pair whose
robot with vision alone is the first to fall.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from pathlib import Path

import imageio_ffmpeg

from renet.evaluation.demo import film_comparison
from renet.evaluation.report.video import VideoCfg
from renet.evaluation.studies.faults import Setting
from renet.evaluation.studies.noise import NoiseStudy

OUT = Path(__file__).parents[1] / "docs" / "figures" / "walk.webp"
NOISE = Setting("flat", 3.0, "salt_and_pepper", 3)
FPS = 10


def main() -> None:
    """Film, and write an animated WebP."""
    study = NoiseStudy()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "film.mp4"
        film_comparison(study, study.make_evaluator(), NOISE, path, VideoCfg(fps=FPS))
        ffmpeg = shutil.which("ffmpeg") or imageio_ffmpeg.get_ffmpeg_exe()
        webp = ["-c:v", "libwebp_anim", "-quality", "40", "-loop", "0", str(OUT)]
        subprocess.run([ffmpeg, "-v", "error", "-y", "-i", str(path), *webp], check=True)
    print(f"{OUT}: {OUT.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
