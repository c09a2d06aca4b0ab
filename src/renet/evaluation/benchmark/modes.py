"""Ways to use a bundle's models: the benchmark's entries, and the rollout's mode of each."""

from typing import Literal

EntryName = Literal["memory", "switch", "camera", "blind", "oracle", "healthy"]
"""memory: VP goes on without images that a monitor objects to. switch: the paper's selector.
camera: VP with every image. blind: OP. oracle: OP while the camera fails. healthy: as camera, with
a camera that never fails."""
HEALTHY = "healthy"
"""The entry whose camera never fails."""
MODES: dict[str, str] = {
    "memory": "memory",
    "switch": "switch",
    "camera": "camera",
    "blind": "blind",
    "oracle": "oracle",
    HEALTHY: "camera",
}
"""The rollout's mode of each entry."""
DEFAULT_ENTRIES = ("memory", "switch", "camera", "blind", HEALTHY)
