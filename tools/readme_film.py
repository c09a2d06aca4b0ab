"""Make the README's moving picture: `python tools/readme_film.py [BUNDLE]`.

It runs the demo's study in nominal conditions, whose film shows the first of 20 pairs of twins
whose left robot alone falls. It writes docs/figures/walk.webp and, beside other results, how many
robots crossed.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from animated_webp import write_webp
from renet.evaluation.demo import DemoStudy
from renet.evaluation.results import write_json

ROOT = Path(__file__).parents[1]
OUT = ROOT / "docs" / "figures" / "walk.webp"
COUNTS = ROOT / "benchmarks" / "results" / "shipped" / "demo.json"


def main() -> None:
    """Walk, film, and write an animated WebP."""
    bundle = Path(sys.argv[1]) if len(sys.argv) > 1 else None
    with tempfile.TemporaryDirectory() as folder:
        study = DemoStudy(Path(folder), bundle, conditions="nominal")
        summary = study.run()
        write_webp(study.out / "film.mp4", OUT, quality=45, width=800)
    summary["settings"] |= {"out": "renet-demo", "bundle": None}
    write_json(COUNTS, summary)


if __name__ == "__main__":
    main()
