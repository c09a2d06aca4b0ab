"""Families of camera faults, and the file of sealed families.

A family collects the faults of one cause. Half of all episodes draw theirs from the loud families,
which a look at the image or at the clock gives away, and half from the lies: images that look
healthy and are wrong.

The file of sealed families is not in the repository, but its SHA-256 is: nobody can tune a policy
to these faults, and results on them can be checked once the file is published.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from renet.errors import RenetError
from renet.faults import FAULTS
from renet.faults.base import FOREVER, Fault
from renet.files import read_bytes

Families = Mapping[str, tuple[str, ...]]
"""Names of the faults of each family."""

# Faults that a look at the image or at the clock gives away.
LOUD: Families = {
    "noise": ("gaussian", "salt_and_pepper"),
    "dark": ("blackout", "saturated"),
    "silent": ("unplugged", "dropped"),
    "late": ("frozen", "latency"),
    "covered": ("occlusion", "blobs"),
    "glare": ("glare", "glare_filled"),
    "holes": ("textureless", "near_field", "edge_shadow"),
    "vegetation": ("grass", "tall_grass"),
    "intermittent": ("intermittent_blackout", "intermittent_frozen", "intermittent_glare"),
}
# Faults whose images look healthy and are wrong.
LIES: Families = {
    "scale": ("wrong_scale", "gain_drift"),
    "mount": ("mount_knocked", "mount_creep", "turned"),
    "mirror": ("mirrored", "split"),
    "half frozen": ("half_frozen", "temporal_filter"),
    "glass": ("glass",),
    "reflection": ("floor_reflection", "wet_patch"),
    "false ground": ("foam",),
    "range": ("wrap_around", "quantised", "disparity_steps"),
    "stray light": ("stray_light",),
}
GLASS = "glass"
"""Name of the family that needs an obstacle above the ground."""
DRAWN_SEVERITIES = (4, 5)
"""Severities of the benchmark's faults, one of which is drawn."""

SEALED_SHA256 = "25f04b712f71d76cce087bef2410488c483db24135c6baa7303b3642d4b320b3"
"""SHA-256 of the file of sealed families."""
_MAX_SEALED_SIZE = 100_000
"""Largest size of that file, bytes."""


def level_at(fault: type[Fault], severity: int) -> float:
    """Return the level of a fault at a severity."""
    # The duration is the episode's: a fault whose level is its duration goes on until then.
    return FOREVER if fault.level_is_duration else fault.level_of(severity)


class SealedFaults:
    """Faults of the sealed file, subclasses of `Fault` that `renet.faults.FAULTS` lacks."""

    def __init__(self, path: Path) -> None:
        """Read the file; raises RenetError unless its hash is `SEALED_SHA256`."""
        source = read_bytes(path, _MAX_SEALED_SIZE, "file of sealed families")
        digest = hashlib.sha256(source).hexdigest()
        if digest != SEALED_SHA256:
            raise RenetError(
                f"{path} is not the file of sealed families of this version: its SHA-256 is"
                f" {digest[:12]}…, not {SEALED_SHA256[:12]}…"
            )
        names: dict[str, object] = {}
        # The file is code; the hash has proved its origin.
        exec(compile(source, str(path), "exec"), names)
        members = names["FAMILIES"]
        assert isinstance(members, dict)
        self.classes: dict[str, type[Fault]] = {}
        """Class of each fault, by its name."""
        families: dict[str, tuple[str, ...]] = {}
        for family, faults in members.items():
            families[family] = tuple(fault.name for fault in faults)
            for fault in faults:
                self.classes[fault.name] = fault
        self.families: Families = families


def draw_fault(rng: np.random.Generator, families: Families) -> tuple[str, str]:
    """Draw a family, then one of its faults, both uniformly; returns their names."""
    family = str(rng.choice(list(families)))
    return family, str(rng.choice(families[family]))


def fault_of(name: str, sealed: SealedFaults | None) -> type[Fault]:
    """Return the class of a fault, by its name; sealed faults need their file."""
    if sealed is not None and name in sealed.classes:
        return sealed.classes[name]
    return FAULTS[name]
