"""Rivals that withhold images, beside those that hand over to OP.

A judge says which cameras are healthy: one that knows (`Oracle`), or a learned one
(`switches.SwitchSelector`). Handing over lets OP drive while the judge objects, as the paper's
switch does; withholding lets VP go on without its images, for as long as the bundle's memory lasts.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from baselines.switches import SwitchEvaluator
from renet.evaluation.evaluator import Evaluator
from renet.evaluation.results import Provenance
from renet.evaluation.rollout import EvalEnv, Rollout, Trial
from renet.interface import PHYSICS_DT, STEPS_PER_TICK
from renet.selector import SelectorInput
from renet.selector.monitors import Gate


class Judge(Protocol):
    """Says which cameras can be trusted."""

    @property
    def probability(self) -> np.ndarray:
        """[N] how much each camera is trusted, 0 to 1."""
        ...

    def update(self, seen: SelectorInput, now: float) -> np.ndarray:
        """One update at 200 Hz; [N] bool, the camera is trusted."""
        ...

    def look(self, seen: SelectorInput) -> Any:
        """A tick begins."""
        ...

    def reset(self, mask: np.ndarray | None = None) -> None:
        """Start anew for the masked robots, by default for all."""
        ...


class Oracle:
    """Knows which cameras are failing."""

    def __init__(self, num_robots: int) -> None:
        self.rollout: Rollout | None = None
        """Whose faults it knows."""
        self._tick = -1
        self._healthy = np.ones(num_robots, bool)

    @property
    def probability(self) -> np.ndarray:
        """[N] 1 or 0."""
        return self._healthy.astype(float)

    def look(self, seen: SelectorInput) -> Gate:
        """Ask which cameras fail in the tick that begins; every image is VP's."""
        assert self.rollout is not None
        self._tick += 1
        self._healthy = ~self.rollout.injector.at_work(self._tick * STEPS_PER_TICK)
        return Gate.open(seen.fresh)

    def update(self, seen: SelectorInput, now: float) -> np.ndarray:
        """What it knew at the tick."""
        return self._healthy

    def distrust(self, mask: np.ndarray, reason: str) -> None:
        """It knows better."""

    def reset(self, mask: np.ndarray | None = None) -> None:
        """A run begins anew; single robots change nothing."""
        if mask is None:
            self._tick = -1


class WithholdingSelector:
    """Withholds the images of cameras that a judge does not trust."""

    def __init__(self, judge: Judge, num_robots: int, longest_memory: float) -> None:
        """Take over a judge; longest_memory: seconds without an image after which OP drives."""
        self.judge = judge
        self._longest = longest_memory
        self._trusted = np.ones(num_robots, bool)
        self._without = np.zeros(num_robots)

    @property
    def probability(self) -> np.ndarray:
        """The judge's."""
        return self.judge.probability

    def look(self, seen: SelectorInput) -> Gate:
        """Which images VP may use in the tick that begins."""
        self.judge.look(seen)
        if isinstance(self.judge, Oracle):
            self._trusted = self.judge.update(seen, 0.0)
        fresh = seen.fresh.astype(bool)
        return Gate(self._trusted & fresh, limits={}, fresh=fresh)

    def update(self, seen: SelectorInput, now: float) -> np.ndarray:
        """[N] bool: VP drives, with or without images."""
        self._trusted = self.judge.update(seen, now)
        self._without = np.where(seen.has_image, 0.0, self._without + PHYSICS_DT)
        return self._without <= self._longest

    def distrust(self, mask: np.ndarray, reason: str) -> None:
        """Let OP drive the masked robots [N], until they have an image again."""
        self._without[mask] = np.inf

    def reset(self, mask: np.ndarray | None = None) -> None:
        """Start anew for the masked robots, by default for all."""
        self.judge.reset(mask)
        rows = slice(None) if mask is None else mask
        self._trusted[rows] = True
        self._without[rows] = 0.0


class RivalEvaluator(SwitchEvaluator):
    """The bundle's policy under a judge, with `withholds` or by handing over."""

    withholds = False
    oracle = False
    entry = "rival"

    @property
    def entries(self) -> dict[str, str]:
        """Of the benchmark: the rollout's mode of the selector."""
        return {self.entry: "memory"}

    def make_selector(self, kind: str, num_robots: int) -> Any:
        """What `memory` obeys: the judge for the newest policy."""
        if kind != "memory" or (self.switch is None and not self.oracle):
            return super().make_selector(kind, num_robots)
        judge = Oracle(num_robots) if self.oracle else super().make_selector(kind, num_robots)
        if not self.withholds:
            return judge
        memory = self.bundle.manifest.selector.longest_memory
        return WithholdingSelector(judge, num_robots, memory)

    def rollout(self, env: EvalEnv, trials: Sequence[Trial], seed: int) -> Rollout:
        """As every evaluator's; an oracle is shown the faults."""
        rollout = Evaluator.rollout(self, env, trials, seed)
        selector: Any = rollout.pilot.selectors["memory"]
        judge = getattr(selector, "judge", selector)
        if isinstance(judge, Oracle):
            judge.rollout = rollout
        return rollout

    def provenance(self, seed: int) -> Provenance:
        """The switch's, with the entry: other results than without the judge."""
        provenance = super().provenance(seed)
        digest = hashlib.sha256(f"{provenance.bundle_hash} {self.entry}".encode()).hexdigest()
        name = f"{self.bundle.name} with {self.entry}"
        return replace(provenance, bundle=name, bundle_hash=digest)
