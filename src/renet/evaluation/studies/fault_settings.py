"""Settings of the study of single faults: grounds, onsets and faults (docs/measure.md)."""

from typing import NamedTuple

from renet.faults import Injection, fault_class
from renet.interface import Terrain, control_steps

FAULT_GROUNDS: dict[Terrain, int] = {
    "flat": 1,
    "stairs_up": 6,
    "stairs_down": 10,
    "obstacles": 10,
    "platform": 6,
    "gap": 3,
}
"""Grounds and their levels, 1 to 10."""
ONSETS = {0.5: "on_the_way", 1.5: "before_the_edge"}
"""Names of the times at which faults begin, s."""
LISTED = (
    "gaussian",
    "salt_and_pepper",
    "blackout",
    "saturated",
    "frozen",
    "dropped",
    "latency",
    "occlusion",
    "blobs",
    "grass",
    "glare",
    "glare_filled",
    "near_field",
    "glass",
    "foam",
    "motion_blur",
    "mount_knocked",
    "wrong_scale",
    "unplugged",
    "edge_shadow",
    "disparity_steps",
    "textureless",
    "tall_grass",
    "glare_dropped",
    "blobs_latency",
    "shadow_steps",
    "intermittent_blackout",
    "intermittent_frozen",
    "intermittent_glare",
)
"""Faults that are studied by default; `renet.faults.FAULTS` has more."""


class Setting(NamedTuple):
    """Ground and fault of a group of robots."""

    ground: str
    """Kind of ground."""
    onset: float
    """Time at which the fault begins, s."""
    fault: str
    """Name of the fault."""
    severity: int
    """Severity of the fault, 1 to 5."""

    @property
    def step(self) -> int:
        """Control step at which the fault begins."""
        return control_steps(self.onset)

    @property
    def level(self) -> float:
        """Strength of the fault, in its own unit."""
        return fault_class(self.fault).level_of(self.severity)

    def injection(self, seconds: float) -> Injection:
        """Return the fault's injection, which lasts `seconds` at most."""
        return Injection.of(self.fault, self.severity, self.step, seconds)
