"""renet: quadruped locomotion that survives the loss of its depth camera (RENet)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from renet.pilot import Pilot

__version__ = "0.2.0"


def load(
    bundle: Path | str = "go1-parkour",
    robots: int = 1,
    mode: str | Sequence[str] = "memory",
    unseen: Literal["walk", "slow", "stop"] = "walk",
) -> Pilot:
    """Load the pilot of a bundle, which turns observations and depth images into joint targets.

    Args:
        bundle: its folder, or the name of one that ships: `go1-parkour`, `go1-driven`,
            `go2-parkour`, `go2-driven`; or `hf://owner/name` on the Hugging Face Hub.
        robots: number of robots, N.
        mode: `memory`, `switch`, `camera` or `blind` for all robots, or a list of N.
        unseen: what robots of the mode `memory` do at the end of the ground that they have seen:
            `walk` on, `slow` down or `stop`.

    Raises:
        RenetError: a bundle that cannot be used, no robot, or an unknown mode or conduct.
    """
    # Late, so that `import renet` stays light.
    from renet.bundle import Bundle
    from renet.pilot import Pilot

    return Pilot.of(Bundle.load(bundle), robots, mode, unseen=unseen)
