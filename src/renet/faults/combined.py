"""Combinations of faults: two at once, and intermittent ones."""

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from renet.faults import image, stereo, timing
from renet.faults.base import SEVERITIES, Fault, Frames
from renet.interface import TICK_DT

PERIOD_FRAMES = 10
"""Frames from one onset of an intermittent fault to the next: 1 s."""


class TwoFaults(Fault):
    """Two faults of the same severity, applied one after the other."""

    unit = "severity"
    levels = SEVERITIES
    kinds: ClassVar[tuple[type[Fault], type[Fault]]]

    def __init__(self, level: float, rngs: Sequence[np.random.Generator]) -> None:
        super().__init__(level, rngs)
        self._faults = [kind(kind.level_of(int(level)), rngs) for kind in self.kinds]

    def corrupt(self, frames: Frames, elapsed: np.ndarray) -> Frames:
        for fault in self._faults:
            frames = fault.corrupt(frames, elapsed)
        return frames

    @classmethod
    def describe(cls, level: float) -> str:
        return " + ".join(kind.describe(kind.level_of(int(level))) for kind in cls.kinds)


class GlareDropped(TwoFaults):
    """Low sun on a slow computer: glare and dropped frames, both of the level's severity."""

    kinds = (image.Glare, timing.Dropped)


class BlobsLatency(TwoFaults):
    """Drops on the lens and a busy bus: blobs and latency, both of the level's severity."""

    kinds = (image.Blobs, timing.Latency)


class ShadowSteps(TwoFaults):
    """A coarse stereo matcher: edge shadows and disparity steps of the level's severity."""

    kinds = (stereo.DisparitySteps, stereo.EdgeShadow)


class Intermittent(Fault):
    """Fault that is active in the first part of each second."""

    unit = "share"
    levels = (0.1, 0.3, 0.5, 0.7, 0.9)
    kind: ClassVar[type[Fault]]
    severity: ClassVar[int]

    def __init__(self, level: float, rngs: Sequence[np.random.Generator]) -> None:
        super().__init__(level, rngs)
        self._fault = self.kind(self.kind.level_of(self.severity), rngs)

    def corrupt(self, frames: Frames, elapsed: np.ndarray) -> Frames:
        phase = np.round(elapsed / TICK_DT).astype(int) % PERIOD_FRAMES
        on = (elapsed >= 0) & (phase < round(self.level * PERIOD_FRAMES))
        return self._fault.corrupt(frames, np.where(on, phase * TICK_DT, -1.0))


class IntermittentBlackout(Intermittent):
    """A loose connector: all zeros in a part of every second; level is that part."""

    kind = image.Blackout
    severity = 5


class IntermittentFrozen(Intermittent):
    """A driver that hangs and recovers: frozen in a part of every second; level is that part."""

    kind = timing.Frozen
    severity = 5


class IntermittentGlare(Intermittent):
    """Sun between trees: glare of severity 5 in a part of every second; level is that part."""

    kind = image.Glare
    severity = 5
