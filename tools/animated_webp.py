"""Animated WebP from a film."""

import shutil
import subprocess
from pathlib import Path

import imageio_ffmpeg

FPS = 12.5
"""Half of the film's pictures."""


def write_webp(film: Path, out: Path, quality: int, width: int) -> None:
    """Convert a film, by ffmpeg, and print the size of the result.

    Args:
        film: The film, in any format of ffmpeg's.
        out: The animated WebP, which is replaced.
        quality: Quality of the pictures, 0 to 100.
        width: Width of the pictures, pixels.
    """
    ffmpeg = shutil.which("ffmpeg") or imageio_ffmpeg.get_ffmpeg_exe()
    source = ["-i", str(film), "-vf", f"fps={FPS},scale={width}:-2"]
    webp = ["-c:v", "libwebp_anim", "-quality", str(quality), "-loop", "0", str(out)]
    subprocess.run([ffmpeg, "-v", "error", "-y", *source, *webp], check=True)
    print(f"{out}: {out.stat().st_size / 1e6:.2f} MB")
