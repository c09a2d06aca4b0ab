"""Selector of the images that VP gets, and of the estimator that drives.

A robot is in one of three states. It sees while VP drives with images. It remembers while VP drives
without images, because a monitor objects to them: such an image is withheld in the tick in which it
arrives. It is blind while OP drives, because the memory is stale or the estimators disagree.

The paper's selector (RENet, Method B) has the reconstruction monitor alone, no dwell and no memory.
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
"""Time without an objection before vision is used again, s."""
BETWEEN_RETURNS = 5.0
"""Shortest time between two returns to vision, s."""
STEADY = 5
"""Number of new images after a late one, or after two surprising ones, from which on VP uses images
again. Images of a camera that often delivers late look healthy, and so do many of one that lies."""
AGREES = 0.5
"""Share of the threshold of surprise below which images must stay after two surprising ones. The
older the last image is, the less is expected, and the less a lie surprises."""
SLOWEST = 1.0
"""Longest delay of the filter, s."""
SELECTORS = ("memory", "switch")
"""Kinds of selectors, named after the pilot's modes that obey them (`interface.PilotMode`)."""
SEES = "sees"
REMEMBERS = "remembers"
BLIND = "blind"
_STATES = np.array((SEES, REMEMBERS, BLIND))
LONGEST_MEMORY = 60.0
"""Longest time for which a bundle may let VP drive without an image, s."""


@dataclass(frozen=True)
class SelectorSpec:
    """Settings of a calibrated selector, which a bundle's manifest stores."""

    beta: float
    """The paper's threshold of the anomaly score."""
    gamma: float = 0.1
    """Weight of a new verdict in the low-pass filter (paper)."""
    rate_hz: float = 200.0
    """Filter updates per second."""
    thresholds: dict[str, float] = field(default_factory=dict)
    """Calibrated thresholds by the monitors' names; a monitor without one uses its fallback."""
    calibration: str = ""
    """Description of the calibration of beta."""
    false_alarms_per_hour: float = 0.0
    """Rate at which healthy robots leave vision with these thresholds; 0 if never calibrated."""
    healthy_hours: float = 0.0
    """Duration of the runs of the calibration, robot hours."""
    longest_memory: float = 0.0
    """Longest time for which VP may drive without an image, s, however small the error of its map
    that it expects. With 0 OP takes over at once, as in the paper."""

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

        These are calibrated ones or the monitors' fallbacks. The fallback of `reconstruction` is
        beta, unless there is a threshold of `variance`, which judges the same images better.
        """
        fallbacks = {name: monitor.fallback for name, monitor in MONITORS.items()}
        if "variance" not in self.thresholds:
            fallbacks["reconstruction"] = self.beta
        thresholds = fallbacks | self.thresholds
        return {name: value for name, value in thresholds.items() if value is not None}


class _Limits(NamedTuple):
    """Thresholds of some monitors as an array, which is built once and read in every step."""

    names: tuple[str, ...]
    """Names of the monitors."""
    values: np.ndarray
    """Smallest scores to object to, [monitors, 1]."""

    @classmethod
    def of(cls, thresholds: Mapping[str, float]) -> "_Limits":
        """Convert thresholds by the monitors' names."""
        return cls(tuple(thresholds), np.array([*thresholds.values()])[:, None])


class MonitorSelector:
    """Selector of N robots: images that VP gets, and the estimator that drives.

    With a memory, VP drives for up to `longest_memory` seconds after its last tick with an image,
    unless a monitor of the estimators objects. Without a memory, VP drives while no monitor
    objects.

    The filter is updated `spec.rate_hz` times a second, however often `update` is called. Updates
    between two calls use the verdicts of the later call: a caller at 50 Hz gives the same verdict
    to a filter of 200 Hz four times, and an image every 0.1 s counts 20 times. The filter thus
    delays the switch by 35 ms and ignores shorter changes, but does not average over images.
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
        """Initialize the selector; all robots begin with vision.

        Args:
            thresholds: Thresholds of the monitors to use, by name.
            spec: Settings, of which this class uses gamma and rate of the filter.
            num_robots: Number of robots, N.
            dwell: Time without an objection before vision is used again, s of the caller's clock.
            between_returns: Shortest time between two returns to vision, s of the same clock.
            longest_memory: Longest time for which VP may drive without an image, s.
        """
        self.spec = spec
        self.dwell = dwell
        self.between_returns = between_returns
        self.longest_memory = longest_memory
        self.thresholds = {name: thresholds[name] for name in MONITORS if name in thresholds}
        """Thresholds of the monitors in use, by name, in the order of `MONITORS`."""
        self.probability = np.ones(num_robots)
        """Vision probability P_t, [N]."""
        self.vision = np.ones(num_robots, bool)
        """True where VP drives, [N] bool."""
        self.without_image = np.zeros(num_robots)
        """Time since VP's newest tick with an image, [N] s; infinite before the first."""
        self.reason = np.full(num_robots, "", object)
        """Reason of the first monitor that objected when the robot last stopped seeing, [N] text;
        empty while it sees."""

        # Monitors that decide who drives, those that withhold images before the vision model has
        # run, and those of the vision model's outputs.
        judged = {}
        before_vision = {}
        self._limits = {}
        for name, limit in self.thresholds.items():
            monitor = MONITORS[name]
            if not (longest_memory and monitor.of_image):
                judged[name] = limit
            if monitor.of_image and not monitor.output:
                before_vision[name] = limit
            if monitor.output:
                self._limits[monitor.output] = limit
        self._judged = _Limits.of(judged)
        self._before_vision = _Limits.of(before_vision)

        # State of the monitors and of the filter.
        self._scorer = Scorer(num_robots)
        self._looked = False
        self._unscored = False
        self._steady = np.full(num_robots, STEADY)
        self._is_new = np.zeros(num_robots, bool)
        self._surprised = np.zeros(num_robots, bool)
        self._lied_to = np.zeros(num_robots, bool)
        self._periods: int | None = None
        self._good_since = np.zeros(num_robots)
        self._last_good = np.full(num_robots, -np.inf)
        self._returned = np.full(num_robots, -np.inf)

    @property
    def state(self) -> np.ndarray:
        """State of each robot, [N] of `SEES`, `REMEMBERS` or `BLIND`."""
        return _STATES[np.where(self.vision, self.without_image > 0, 2)]

    def look(self, seen: SelectorInput) -> Gate:
        """Judge the images of a tick before the vision model runs; called once in every tick.

        Args:
            seen: State of vision, of which image, fresh, age and invalid are used.

        Returns:
            Gate that withholds images from VP; without a memory VP uses all images.
        """
        verdicts = self._verdicts(seen, self._before_vision)
        self._looked = True
        self._unscored = True
        if not self.longest_memory:
            return Gate.open(seen.fresh)
        late = seen.age >= self.thresholds.get("frame_age", math.inf)
        self._steady = np.where(late, 0, self._steady + seen.fresh)
        self._is_new = seen.fresh
        # VP must not use an image twice.
        acceptable = seen.fresh & (self._steady >= STEADY)
        acceptable &= np.logical_and.reduce(verdicts)
        return Gate(acceptable, self._limits, fresh=seen.fresh)

    def update(self, seen: SelectorInput, now: float) -> np.ndarray:
        """Judge vision at one time, and decide who drives.

        Args:
            seen: State of vision, with the fields that the monitors need.
            now: Time on any clock, s. While it stands still or runs backwards, nothing is decided.

        Returns:
            True where VP drives, [N] bool.
        """
        # Once in every tick, as soon as its scores are there.
        if self._unscored and seen.scored:
            self._heed_surprise(seen)
            self._unscored = False
        # `look` has counted these images.
        if self._looked and seen.fresh.any():
            seen = replace(seen, fresh=np.zeros_like(seen.fresh))
        self._looked = False
        # In every call, because the scorer counts images.
        verdicts = self._verdicts(seen, self._judged)
        due = self._due(now)
        if due == 0:
            return self.vision

        # `good`: VP has a good image. `healthy`: VP may drive, perhaps without an image.
        healthy = np.logical_and.reduce(verdicts)
        good = healthy
        if self.longest_memory:
            good = seen.has_image
            self._last_good = np.where(good, now, self._last_good)
            self.without_image = now - self._last_good
            healthy = healthy & (self.without_image <= self.longest_memory)

        # Filter the verdicts (RENet eq. 5).
        self.probability = low_pass(self.probability, healthy, self.spec.gamma, due)
        likely = self.probability > VISION_THRESHOLD
        self._good_since = np.where(good & healthy, np.minimum(self._good_since, now), np.inf)
        # Almost always all robots see and continue to see.
        if (self.vision & likely & good & healthy).all():
            self.reason[:] = ""
            return self.vision

        # Robots that leave vision or return to it. Tolerances are for rounding of the clock.
        leaving = self.vision & ~likely
        has_dwelt = now - self._good_since >= self.dwell - 1e-9
        has_rested = now - self._returned >= self.between_returns - 1e-9
        returning = ~self.vision & likely & has_dwelt & has_rested
        self._returned[returning] = now
        self.vision = (self.vision & likely) | returning
        self._update_reasons(seen, good, healthy, leaving)
        return self.vision

    def _heed_surprise(self, seen: SelectorInput) -> None:
        """Let VP wait for good images in a row where two in a row were surprising.

        An old image is not counted: it surprises because the robot has moved on.
        """
        limit = self.thresholds.get("surprise", math.inf)
        surprising = self._is_new & (seen.surprise >= limit)
        self._lied_to |= surprising & self._surprised
        self._surprised = np.where(self._is_new, surprising, self._surprised)
        disagrees = self._is_new & (seen.surprise >= AGREES * limit)
        self._steady[self._lied_to & disagrees] = 0
        self._lied_to &= self._steady < STEADY

    def _update_reasons(
        self, seen: SelectorInput, good: np.ndarray, healthy: np.ndarray, leaving: np.ndarray
    ) -> None:
        """Set the reasons of robots that stop seeing, and clear those of robots that see.

        Args:
            seen: State of vision.
            good: True where VP has a good image, [N] bool.
            healthy: True where VP may drive, [N] bool.
            leaving: True for robots that leave vision now, [N] bool.
        """
        self.reason[self.vision & good] = ""
        # With a memory, a robot needs a reason as soon as it has no image.
        ceasing = ~good & (self.reason == "") if self.longest_memory else leaving
        self._explain(~(good & healthy) & (leaving | ceasing), seen)
        if not self.longest_memory:
            return
        # A memory ends because the first cause lasts, which is appended to its reason.
        expired = leaving & np.isfinite(self.without_image)
        expired &= self.without_image > self.longest_memory
        lasts = f" for {self.longest_memory:g} s, as long as it remembers"
        for robot in np.flatnonzero(expired):
            self.reason[robot] += lasts

    def _verdicts(self, seen: SelectorInput, limits: "_Limits") -> np.ndarray:
        """Return the monitors' verdicts, [monitors, N] bool; True for healthy vision."""
        return self._scorer.scores(seen, limits.names) < limits.values

    def _explain(self, robots: np.ndarray, seen: SelectorInput) -> None:
        """Set the reason of each masked robot, [N] bool, to that of the first monitor to object."""
        if not robots.any():
            return
        # The scorer has counted the images already.
        counted = replace(seen, fresh=np.zeros_like(seen.fresh))
        verdicts = self._verdicts(counted, _Limits.of(self.thresholds))
        for robot in np.flatnonzero(robots):
            for name, good in zip(self.thresholds, verdicts[:, robot], strict=True):
                # A monitor of images does not replace the reason of the first withheld image.
                if not good and not (self.reason[robot] and MONITORS[name].of_image):
                    self.reason[robot] = MONITORS[name].reason
                    break
            else:
                # No monitor objects to an image that is withheld after a late one.
                if self._steady[robot] < STEADY and not self.reason[robot]:
                    self.reason[robot] = MONITORS["frame_age"].reason

    def distrust(self, mask: np.ndarray, reason: str) -> None:
        """Let OP drive the masked robots, [N] bool, at once, whatever the monitors say."""
        self.probability[mask] = 0.0
        self.vision = self.vision & ~mask
        self._good_since[mask] = np.inf
        self._last_good[mask] = -np.inf
        self.reason[mask] = reason

    def reset(self, mask: np.ndarray | None = None) -> None:
        """Use vision again, and forget the past of the masked robots, [N] bool; by default all."""
        if mask is None:
            self._periods = None
            mask = np.ones(len(self.vision), bool)
        self.probability[mask] = 1.0
        self.vision = self.vision | mask
        self.without_image[mask] = 0.0
        self.reason[mask] = ""
        self._last_good[mask] = -np.inf
        self._returned[mask] = -np.inf
        self._steady[mask] = STEADY
        self._surprised[mask] = False
        self._lied_to[mask] = False
        self._scorer.reset(mask)

    def _due(self, now: float) -> int:
        """Return the number of filter updates since the last call, at multiples of their period."""
        ticks = now * self.spec.rate_hz
        # The tolerance keeps rounding of the clock from losing an update.
        periods = math.floor(ticks + 1e-4)
        last = math.ceil(ticks - 1e-4) - 1 if self._periods is None else self._periods
        self._periods = max(last, periods)
        return self._periods - last


def check_selector(spec: SelectorSpec) -> None:
    """Raise RenetError for a selector that would not leave a broken camera in about a second.

    Studies may build such selectors, but bundles must not contain them.
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
    """Build a selector.

    Args:
        kind: One of `SELECTORS`.
        spec: Settings.
        num_robots: Number of robots, N.

    Raises:
        RenetError: There is no such kind.
    """
    demand_name("selector", kind, SELECTORS)
    if kind == "switch":
        beta = {"reconstruction": spec.beta}
        return MonitorSelector(beta, spec, num_robots, dwell=0.0, between_returns=0.0)
    memory = spec.longest_memory
    return MonitorSelector(spec.used_thresholds, spec, num_robots, longest_memory=memory)
