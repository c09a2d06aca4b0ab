"""The selector: which images VP gets, and whether VP or OP drives.

A robot is in one of three states. It sees while VP drives and gets its images. It remembers while
VP drives without images: one that a monitor objects to is withheld in the tick in which it arrives.
It is blind while OP drives, because the memory is stale or the estimators disagree.

With the reconstruction monitor alone, no dwell and no memory it is the paper's selector (RENet,
Method B).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from renet.errors import RenetError, demand_name
from renet.selector.filter import VISION_THRESHOLD, filter_delay, low_pass
from renet.selector.monitors import MONITORS, Gate, Scorer, SelectorInput

DWELL = 1.0
"""Seconds without an objection before vision is used again."""
BETWEEN_RETURNS = 5.0
"""Shortest time in seconds between two returns to vision."""
STEADY = 5
"""New images since one was late from which on VP uses them again: those of a camera that delivers
late look healthy, but come now and then."""
SLOWEST = 1.0
"""Longest delay of the filter in seconds."""
SELECTORS = ("memory", "switch")
"""Selectors by the pilot's mode that obeys them (`interface.PilotMode`)."""
SEES, REMEMBERS, BLIND = STATES = ("sees", "remembers", "blind")
_STATES = np.array(STATES)
LONGEST_MEMORY = 60.0
"""Most seconds for which a bundle may let VP drive without an image."""


@dataclass(frozen=True)
class SelectorSpec:
    """A calibrated selector, as a bundle's manifest stores it."""

    beta: float
    """The paper's threshold on the anomaly score."""
    gamma: float = 0.1
    """Weight of a new verdict in the low-pass filter (paper)."""
    rate_hz: float = 200.0
    """Filter updates per second."""
    thresholds: dict[str, float] = field(default_factory=dict)
    """Calibrated thresholds by monitor name; a monitor without one uses its fallback."""
    calibration: str = ""
    """How beta was found."""
    false_alarms_per_hour: float = 0.0
    """Rate at which healthy robots leave vision with these thresholds; 0: never calibrated."""
    healthy_hours: float = 0.0
    """Robot hours the thresholds were learnt from."""
    longest_memory: float = 0.0
    """Seconds for which VP may drive without an image, whatever error of its map it expects; 0: OP
    takes over at once (the paper's switch)."""

    def __post_init__(self) -> None:
        for name in ("beta", "rate_hz"):
            value = getattr(self, name)
            if not 0.0 < value < math.inf:
                raise RenetError(f"selector.{name} must be positive and finite, got {value}")
        if not 0.0 < self.gamma <= 1.0:
            raise RenetError(f"selector.gamma must be within 0 and 1, got {self.gamma}")
        if not 0.0 <= self.longest_memory < math.inf:
            raise RenetError(
                f"selector.longest_memory must be finite, from 0 s, got {self.longest_memory}"
            )
        for name in self.thresholds:
            demand_name("monitor", name, MONITORS)

    @property
    def used_thresholds(self) -> dict[str, float]:
        """Thresholds of the monitors that the mode `memory` uses, by name.

        Calibrated ones, else the monitor's fallback. The reconstruction falls back to beta, unless
        there is a threshold of the variance, which judges the same images better.
        """
        fallbacks = {name: monitor.fallback for name, monitor in MONITORS.items()}
        if "variance" not in self.thresholds:
            fallbacks["reconstruction"] = self.beta
        thresholds = fallbacks | self.thresholds
        return {name: value for name, value in thresholds.items() if value is not None}


class _Limits(NamedTuple):
    """Monitors, and the least score to which each objects: made once, read at every step."""

    names: tuple[str, ...]
    values: np.ndarray
    """[monitors, 1]"""

    @classmethod
    def of(cls, thresholds: Mapping[str, float]) -> "_Limits":
        """Those of thresholds by the monitor's name."""
        return cls(tuple(thresholds), np.array([*thresholds.values()])[:, None])


class MonitorSelector:
    """Decides for N robots which images VP gets and whether VP or OP drives.

    VP drives while it sees or remembers: while its newest tick had an image, or for
    `longest_memory` seconds after the last one that had, unless a monitor of the estimators
    objects. Without a memory, every monitor speaks for itself: VP drives while none objects.

    However often `update` is called, the filter takes `spec.rate_hz` verdicts a second. Verdicts
    due between two calls are those of the later call: a caller at 50 Hz hands the same verdict to a
    200 Hz filter four times, and an image every 0.1 s counts 20 times. So the filter delays the
    switch by 35 ms and smooths shorter flicker, but does not average over images.
    """

    def __init__(
        self,
        thresholds: Mapping[str, float],
        spec: SelectorSpec,
        num_robots: int = 1,
        dwell: float = DWELL,
        between_returns: float = BETWEEN_RETURNS,
        longest_memory: float = 0.0,
    ) -> None:
        """Let N robots begin with vision.

        Args:
            thresholds: of the monitors to use, by name.
            spec: gives the filter's gamma and rate.
            num_robots: N.
            dwell: seconds of the caller's clock without an objection before vision is used again.
            between_returns: shortest time between two returns to vision, s of the same clock.
            longest_memory: seconds for which VP may drive without an image.
        """
        self.spec, self.dwell, self.between_returns = spec, dwell, between_returns
        self.longest_memory = longest_memory
        self.thresholds = {name: thresholds[name] for name in MONITORS if name in thresholds}
        """Thresholds of the monitors in use, by name, in the order of `MONITORS`."""
        self.probability = np.ones(num_robots)
        """Vision probability P_t, [N]."""
        self.vision = np.ones(num_robots, bool)
        """Whether each robot uses vision, [N]."""
        self.without_image = np.zeros(num_robots)
        """Seconds since VP's newest tick with an image, [N]; infinite before the first."""
        self.reason = np.full(num_robots, "", object)
        """Reason of the first monitor that objected when the robot last ceased to see, [N]; empty
        while it sees."""
        used = [(MONITORS[name], name, limit) for name, limit in self.thresholds.items()]
        self._judged = _Limits.of({n: x for m, n, x in used if not (longest_memory and m.of_image)})
        self._before_vision = _Limits.of({n: x for m, n, x in used if m.of_image and not m.output})
        self._limits = {m.output: limit for m, _, limit in used if m.output}
        self._scorer = Scorer(num_robots)
        self._looked = False
        self._since_late = np.full(num_robots, STEADY)
        self._periods: int | None = None
        self._good_since = np.zeros(num_robots)
        self._last_good = np.full(num_robots, -np.inf)
        self._returned = np.full(num_robots, -np.inf)

    @property
    def state(self) -> np.ndarray:
        """Whether each robot sees, remembers or is blind, [N] of `STATES`."""
        return _STATES[np.where(self.vision, self.without_image > 0, 2)]

    def look(self, seen: SelectorInput) -> Gate | None:
        """Judge the images of a tick before the vision model runs; called once in every tick.

        Args:
            seen: image, fresh, age and invalid; the rest is ignored.

        Returns:
            Which images VP may use; None without a memory: all.
        """
        verdicts = self._verdicts(seen, self._before_vision)
        self._looked = True
        if not self.longest_memory:
            return None
        late = seen.age >= self.thresholds.get("frame_age", math.inf)
        self._since_late = np.where(late, 0, self._since_late + seen.fresh)
        # An image that is shown again is no new one.
        acceptable = seen.fresh & (self._since_late >= STEADY)
        return Gate(acceptable & np.logical_and.reduce(verdicts), self._limits)

    def update(self, seen: SelectorInput, now: float) -> np.ndarray:
        """Judge vision at one moment, and decide who drives.

        Args:
            seen: the fields that the monitors need.
            now: seconds on any clock; while it stands or runs backwards nothing is decided.

        Returns:
            Whether VP drives, [N] bool.
        """
        if self._looked and seen.fresh.any():  # `look` has counted these images.
            seen = replace(seen, fresh=np.zeros_like(seen.fresh))
        self._looked = False
        verdicts = self._verdicts(seen, self._judged)  # At every call: it counts images.
        due = self._due(now)
        if due == 0:
            return self.vision
        good = healthy = np.logical_and.reduce(verdicts)
        if self.longest_memory:  # VP has a good image; and it may drive, perhaps without one.
            good = seen.has_image
            self._last_good = np.where(good, now, self._last_good)
            self.without_image = now - self._last_good
            healthy = healthy & (self.without_image <= self.longest_memory)
        self.probability = low_pass(self.probability, healthy, self.spec.gamma, due)
        likely = self.probability > VISION_THRESHOLD
        self._good_since = np.where(good & healthy, np.minimum(self._good_since, now), np.inf)
        if (self.vision & likely & good & healthy).all():  # As almost always.
            self.reason[:] = ""
            return self.vision
        leaving = self.vision & ~likely
        dwelt = now - self._good_since >= self.dwell - 1e-9
        rested = now - self._returned >= self.between_returns - 1e-9
        returning = ~self.vision & likely & dwelt & rested
        self._returned[returning] = now
        self.vision = (self.vision & likely) | returning
        self.reason[self.vision & good] = ""
        ceasing = ~good & (self.reason == "") if self.longest_memory else leaving
        self._explain(~(good & healthy) & (leaving | ceasing), seen)
        if self.longest_memory:
            # What spoilt the images is no news: that it lasts ends the memory.
            expired = leaving & np.isfinite(self.without_image)
            expired &= self.without_image > self.longest_memory
            lasts = f" for {self.longest_memory:g} s, as long as it remembers"
            for robot in np.flatnonzero(expired):
                self.reason[robot] += lasts
        return self.vision

    def _verdicts(self, seen: SelectorInput, limits: "_Limits") -> np.ndarray:
        """Whether each monitor finds vision healthy, [monitors, N] bool."""
        return self._scorer.scores(seen, limits.names) < limits.values

    def _explain(self, robots: np.ndarray, seen: SelectorInput) -> None:
        """Set the reason of the masked robots [N] to that of the first monitor that objects."""
        if not robots.any():
            return
        counted = replace(seen, fresh=np.zeros_like(seen.fresh))
        verdicts = self._verdicts(counted, _Limits.of(self.thresholds))
        for robot in np.flatnonzero(robots):
            for name, good in zip(self.thresholds, verdicts[:, robot], strict=True):
                # The first withheld image gave the reason.
                if not good and not (self.reason[robot] and MONITORS[name].of_image):
                    self.reason[robot] = MONITORS[name].reason
                    break
            else:
                if self._since_late[robot] < STEADY and not self.reason[robot]:
                    self.reason[robot] = MONITORS["frame_age"].reason

    def distrust(self, mask: np.ndarray, reason: str) -> None:
        """Let OP drive the masked robots [N] at once, whatever the monitors say, for a reason."""
        self.probability[mask] = 0.0
        self.vision = self.vision & ~mask
        self._good_since[mask] = np.inf
        self._last_good[mask] = -np.inf
        self.reason[mask] = reason

    def reset(self, mask: np.ndarray | None = None) -> None:
        """Use vision again and forget the past of the masked robots [N], by default of all."""
        if mask is None:
            self._periods = None
            mask = np.ones(len(self.vision), bool)
        self.probability[mask] = 1.0
        self.vision = self.vision | mask
        self.without_image[mask] = 0.0
        self.reason[mask] = ""
        self._last_good[mask] = self._returned[mask] = -np.inf
        self._since_late[mask] = STEADY
        self._scorer.reset(mask)

    def _due(self, now: float) -> int:
        """Filter updates due since the last call, at multiples of their period."""
        ticks = now * self.spec.rate_hz
        # Rounding of the clock must not swallow an update.
        periods = math.floor(ticks + 1e-4)
        last = math.ceil(ticks - 1e-4) - 1 if self._periods is None else self._periods
        self._periods = max(last, periods)
        return self._periods - last


def check_selector(spec: SelectorSpec) -> None:
    """Raise RenetError for a selector that would not leave a broken camera within a second or so.

    Studies may build such selectors; no bundle may hold one.
    """
    if not 10.0 <= spec.rate_hz <= 1000.0:
        raise RenetError(f"selector.rate_hz must be from 10 to 1000 Hz, got {spec.rate_hz:g}")
    if spec.longest_memory > LONGEST_MEMORY:
        raise RenetError(
            f"selector.longest_memory {spec.longest_memory:g} s is longer than {LONGEST_MEMORY:g} s"
        )
    delay = filter_delay(spec.gamma, spec.rate_hz)
    if delay > SLOWEST:
        raise RenetError(
            f"selector.gamma {spec.gamma:g} at {spec.rate_hz:g} Hz delays a switch by {delay:g} s, "
            f"at most {SLOWEST:g} s are allowed"
        )
    for name, value in (("beta", spec.beta), *spec.thresholds.items()):
        limit = MONITORS["reconstruction" if name == "beta" else name].limit
        if not value <= limit:
            raise RenetError(
                f"selector threshold {name} {value:g} would never object, at most {limit:g}"
            )


def make_selector(kind: str, spec: SelectorSpec, num_robots: int = 1) -> MonitorSelector:
    """A selector for N robots by its name, one of `SELECTORS`; raises RenetError for another."""
    demand_name("selector", kind, SELECTORS)
    if kind == "switch":
        beta = {"reconstruction": spec.beta}
        return MonitorSelector(beta, spec, num_robots, dwell=0.0, between_returns=0.0)
    thresholds, memory = spec.used_thresholds, spec.longest_memory
    return MonitorSelector(thresholds, spec, num_robots, longest_memory=memory)
