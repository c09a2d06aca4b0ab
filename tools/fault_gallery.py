"""Draw every fault at its severities: `python tools/fault_gallery.py`, docs/figures/faults.webp."""

from __future__ import annotations

import tempfile
from pathlib import Path

from PIL import Image

from renet.evaluation import figures
from renet.evaluation.report.fault_gallery import draw_gallery
from renet.evaluation.results import Provenance
from renet.faults import FAULTS

OUT = Path(__file__).parents[1] / "docs" / "figures" / "faults.webp"
SEED = 1
WIDTH = 1100
"""Pixels."""


def main() -> None:
    """Draw, shrink, and write a WebP."""
    with tempfile.TemporaryDirectory() as folder:
        where = Provenance("no policy", "", "MuJoCo", SEED)
        drawn, path = draw_gallery(list(FAULTS), SEED), Path(folder) / "faults.png"
        picture = Image.open(figures.save(drawn, path, where))
        height = round(picture.height * WIDTH / picture.width)
        picture.convert("RGB").resize((WIDTH, height), Image.Resampling.LANCZOS).save(
            OUT, quality=60
        )
    print(f"{OUT}: {OUT.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
