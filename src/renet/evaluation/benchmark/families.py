"""Families of camera faults, and families that are sealed.

A family is a cause. Half of all episodes draw theirs among the loud ones, which a look at the image
or at the clock gives away, half among lies: images that look healthy and are wrong.

Sealed families are a file that is not in the repository. Its SHA-256 is, so that results on them
can be checked once the file is published, and nobody can tune a policy to them before.
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
"""The family that needs an obstacle on the ground."""
SEVERITIES = (4, 5)
"""Severities that are drawn."""

SEALED_SHA256 = "25f04b712f71d76cce087bef2410488c483db24135c6baa7303b3642d4b320b3"
"""SHA-256 of the file of sealed families."""
MAX_SEALED = 100_000
"""Bytes of that file."""


def level_at(fault: type[Fault], severity: int) -> float:
    """Level of a fault at a severity; how long it lasts is the episode's matter, not its own."""
    return FOREVER if fault.level_is_duration else fault.level_of(severity)


class SealedFaults:
    """Faults of the sealed file: classes of `Fault` that are in no catalogue."""

    def __init__(self, path: Path) -> None:
        """Read the file; raises RenetError unless it is the one whose hash is known here."""
        source = read_bytes(path, MAX_SEALED, "file of sealed families")
        digest = hashlib.sha256(source).hexdigest()
        if digest != SEALED_SHA256:
            raise RenetError(
                f"{path} is not the file of sealed families of this version: its SHA-256 is"
                f" {digest[:12]}…, not {SEALED_SHA256[:12]}…"
            )
        names: dict[str, object] = {}
        # The hash says whose code this is.
        exec(compile(source, str(path), "exec"), names)
        classes = names["FAMILIES"]
        assert isinstance(classes, dict)
        self.classes: dict[str, type[Fault]] = {
            fault.name: fault for members in classes.values() for fault in members
        }
        """By name."""
        self.families: Families = {
            family: tuple(fault.name for fault in members) for family, members in classes.items()
        }


def draw_fault(rng: np.random.Generator, families: Families) -> tuple[str, str]:
    """Draw a family, and a fault of it: both uniformly."""
    family = str(rng.choice(list(families)))
    return family, str(rng.choice(families[family]))


def fault_of(name: str, sealed: SealedFaults | None = None) -> type[Fault]:
    """The class of a fault by its name."""
    if sealed is not None and name in sealed.classes:
        return sealed.classes[name]
    return FAULTS[name]
