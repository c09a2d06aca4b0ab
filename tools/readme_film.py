"""Make the README's moving picture: `python tools/readme_film.py [BUNDLE]`.

It runs the demo's study, whose film shows the first of 20 pairs of twins whose left robot alone
falls. It writes docs/figures/walk.webp and, beside other results, how many robots crossed.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import imageio_ffmpeg

from renet.evaluation.demo import DemoStudy
from renet.evaluation.results import write_json

ROOT = Path(__file__).parents[1]
OUT = ROOT / "docs" / "figures" / "walk.webp"
COUNTS = ROOT / "benchmarks" / "results" / "shipped" / "demo.json"
FPS = 12.5
"""Half of the film's pictures."""


def main() -> None:
    """Walk, film, and write an animated WebP."""
    bundle = Path(sys.argv[1]) if len(sys.argv) > 1 else None
    with tempfile.TemporaryDirectory() as folder:
        study = DemoStudy(Path(folder), bundle)
        summary = study.run()
        ffmpeg = shutil.which("ffmpeg") or imageio_ffmpeg.get_ffmpeg_exe()
        film = ["-i", str(study.out / "film.mp4"), "-vf", f"fps={FPS}"]
        webp = ["-c:v", "libwebp_anim", "-quality", "45", "-loop", "0", str(OUT)]
        subprocess.run([ffmpeg, "-v", "error", "-y", *film, *webp], check=True)
    summary["settings"] |= {"out": "renet-demo", "bundle": None}
    write_json(COUNTS, summary)
    print(f"{OUT}: {OUT.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
