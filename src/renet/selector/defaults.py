"""The monitors every selector of renet runs with, and what their thresholds are by default."""

from __future__ import annotations

from collections.abc import Mapping

from renet.errors import RenetError
from renet.selector.monitors import (
    Disagreement,
    Duplicate,
    FrameAge,
    InvalidFraction,
    Monitor,
    Nearness,
    Reconstruction,
    Uniformity,
)

MONITORS: dict[str, type[Monitor]] = {
    # The first to object is named as the reason: the plainest causes come first.
    monitor.name: monitor
    for monitor in (
        FrameAge,
        Duplicate,
        InvalidFraction,
        Uniformity,
        Nearness,
        Reconstruction,
        Disagreement,
    )
}
FALLBACK = {
    "frame_age": 0.2,
    "duplicate": 3.0,
    "invalid_fraction": 0.25,
    "uniformity": -0.03,
    "nearness": 0.5,
}
"""Thresholds for bundles that were never calibrated: two missed frames, three equal images, a
quarter of the pixels without depth (a cropped D435 image has under a tenth), an image without
contrast, a lens half covered. Reconstruction falls back to the paper's β. Disagreement has no
natural scale: it is calibrated or not used."""
FLOORS = {name: FALLBACK[name] for name in ("frame_age", "duplicate", "invalid_fraction")}
"""Calibration never goes below these: a simulated camera has no holes and never misses a frame, so
that healthy runs say nothing of what a real one may be forgiven."""

CEILINGS = {"uniformity": -0.005, "nearness": 0.9}
"""Nor above these, whatever healthy runs say: a blank image or a covered lens must be noticed."""


def default_monitors(
    beta: float, thresholds: Mapping[str, float], num_robots: int
) -> list[Monitor]:
    """Fresh monitors for N robots.

    Args:
        beta: the paper's threshold on the anomaly score.
        thresholds: calibrated ones by monitor name; those missing fall back, see `FALLBACK`.
        num_robots: N.

    Raises:
        RenetError: a threshold for a monitor that does not exist.
    """
    unknown = sorted(set(thresholds) - set(MONITORS))
    if unknown:
        raise RenetError(f"unknown monitor '{unknown[0]}': choose among {', '.join(MONITORS)}")
    known = {"reconstruction": beta} | FALLBACK | dict(thresholds)
    return [
        Duplicate(num_robots, known[name]) if monitor is Duplicate else monitor(known[name])
        for name, monitor in MONITORS.items()
        if name in known
    ]
