"""Faults made of others: two at once, and one that comes and goes."""

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from renet.faults import image, stereo, timing
from renet.faults.base import SEVERITIES, TICK, Fault, Frames

PERIOD = 10
"""Frames from one onset of an intermittent fault to the next: 1 s."""


class TwoFaults(Fault):
    """Two faults of the same severity, the second spoils what the first leaves."""

    unit = "severity"
    levels = SEVERITIES
    kinds: ClassVar[tuple[type[Fault], type[Fault]]]

    def __init__(self, level: float, rngs: Sequence[np.random.Generator]) -> None:
        super().__init__(level, rngs)
        self._faults = [kind(kind.level_of(int(level)), rngs) for kind in self.kinds]

    def corrupt(self, frames: Frames, elapsed: np.ndarray) -> Frames:
        """The frames after both."""
        for fault in self._faults:
            frames = fault.corrupt(frames, elapsed)
        return frames

    @classmethod
    def describe(cls, level: float) -> str:
        """Both levels."""
        return " + ".join(kind.describe(kind.level_of(int(level))) for kind in cls.kinds)


class GlareDropped(TwoFaults):
    """Low sun, and a processor that is too warm to keep up."""

    name = "glare_dropped"
    summary = "Glare, and frames are lost, both at the severity that is the level."
    kinds = (image.Glare, timing.Dropped)


class BlobsLatency(TwoFaults):
    """Drops on the lens, and a bus that is too busy."""

    name = "blobs_latency"
    summary = "Blobs on the lens, and frames come late, both at the severity that is the level."
    kinds = (image.Blobs, timing.Latency)


class ShadowSteps(TwoFaults):
    """A stereo camera with a coarse matcher."""

    name = "shadow_steps"
    summary = "Edge shadows and disparity steps, both at the severity that is the level."
    kinds = (stereo.DisparitySteps, stereo.EdgeShadow)


class Intermittent(Fault):
    """A fault that is at work in the first part of every second."""

    unit = "share"
    levels = (0.1, 0.3, 0.5, 0.7, 0.9)
    kind: ClassVar[type[Fault]]
    severity: ClassVar[int]

    def __init__(self, level: float, rngs: Sequence[np.random.Generator]) -> None:
        super().__init__(level, rngs)
        self._fault = self.kind(self.kind.level_of(self.severity), rngs)

    def corrupt(self, frames: Frames, elapsed: np.ndarray) -> Frames:
        """The frames, spoilt where the fault is on."""
        phase = np.round(elapsed / TICK).astype(int) % PERIOD
        on = (elapsed >= 0) & (phase < round(self.level * PERIOD))
        return self._fault.corrupt(frames, np.where(on, phase * TICK, -1.0))


class IntermittentBlackout(Intermittent):
    """A loose connector: the picture goes to zero and comes back."""

    name = "intermittent_blackout"
    summary = "The picture is all zeros in a part of every second; level is that part."
    kind, severity = image.Blackout, 5


class IntermittentFrozen(Intermittent):
    """A driver that hangs and recovers."""

    name = "intermittent_frozen"
    summary = "The last image is delivered as new in a part of every second; level is that part."
    kind, severity = timing.Frozen, 5


class IntermittentGlare(Intermittent):
    """Sun between trees."""

    name = "intermittent_glare"
    summary = "Glare of severity 5 in a part of every second; level is that part."
    kind, severity = image.Glare, 5
