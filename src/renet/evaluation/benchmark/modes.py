"""Entries of the benchmark: ways to use a bundle's models, and the rollout's mode of each."""

from typing import Literal

EntryName = Literal["memory", "switch", "camera", "blind", "oracle", "healthy"]
"""Name of an entry.

memory: VP walks, and goes on without the images that a monitor rejects.
switch: the paper's selector between VP and OP.
camera: VP with every image.
blind: OP.
oracle: VP, and OP exactly while the camera fails.
healthy: mode camera, with a camera that never fails.
"""
HEALTHY = "healthy"
"""The entry whose camera never fails."""
ROLLOUT_MODES: dict[str, str] = {
    "memory": "memory",
    "switch": "switch",
    "camera": "camera",
    "blind": "blind",
    "oracle": "oracle",
    # The rollout knows no such mode: only the faults are missing.
    HEALTHY: "camera",
}
"""The rollout's mode of each entry."""
DEFAULT_ENTRIES = ("memory", "switch", "camera", "blind", HEALTHY)
"""Entries that a bundle walks as by default."""
