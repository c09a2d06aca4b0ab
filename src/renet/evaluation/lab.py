"""What every study works with: a bundle, its policy and selector, and worlds to put them in."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
import warp as wp

from renet.deploy.bundle import Bundle
from renet.deploy.manifest import SelectorSpec
from renet.deploy.policy import Policy
from renet.errors import RenetError
from renet.evaluation.faults import Frames
from renet.evaluation.results import Provenance
from renet.evaluation.rollout import Controller, Switch
from renet.evaluation.world import SimWorld, study_env_cfg
from renet.selector.selector import Selector, SelectorCfg
from renet.tasks import RenetEnvCfg
from renet.vocabulary import PHYSICS_DT


class Lab:
    """One bundle under study; a third party's policy overrides `controller` and `switch`."""

    def __init__(self, bundle: Path | None = None, engine: str = "auto") -> None:
        """Load a bundle.

        Args:
            bundle: its folder; the one that ships with renet by default.
            engine: auto, native or warp.

        Raises:
            RenetError: a missing, damaged or incompatible bundle.
        """
        wp.config.quiet = True
        self.bundle = Bundle.load(bundle, threads=2)
        self.engine = engine
        self.scene_spec: mujoco.MjSpec | None = None
        """The scene of the latest world, for pictures."""

    @property
    def beta(self) -> float:
        """The selector's threshold on the anomaly score."""
        return self.bundle.manifest.selector.beta

    def provenance(self, seed: int) -> Provenance:
        """Where numbers made with this bundle now come from."""
        engine = "native" if self.engine == "auto" else self.engine
        return Provenance.now(self.bundle.name, self.bundle.sha256, engine, seed)

    def world(
        self, task: str | RenetEnvCfg, robots: Sequence[int], speed: float, seed: int
    ) -> SimWorld:
        """Robots that are told to walk straight ahead.

        Args:
            task: id, or a configuration made with `play=True`.
            robots: one number for each row; rows of the same number are twins.
            speed: commanded, m/s.
            seed: of bodies and starts.
        """
        world = SimWorld(study_env_cfg(task, speed), robots, seed, self.engine)
        self.scene_spec = world.scene_spec
        return world

    def controller(self, num_robots: int) -> Controller:
        """The policy under study."""
        return Policy(self.bundle, num_robots)

    def switch(self, num_robots: int) -> Switch:
        """The bundle's selector."""
        return ScoreSwitch(self.bundle.manifest.selector, num_robots)


class ScoreSwitch:
    """The paper's selector as a `Switch` of rollouts: it looks at the anomaly score alone."""

    def __init__(self, spec: SelectorSpec, num_robots: int) -> None:
        """Set up; raises RenetError for a rate that is no whole fraction of the physics rate."""
        self._every = round(1.0 / (PHYSICS_DT * spec.rate_hz))
        if self._every < 1 or abs(self._every * PHYSICS_DT * spec.rate_hz - 1.0) > 1e-6:
            raise RenetError(
                f"selector rate {spec.rate_hz} Hz: rollouts update it at 200 Hz or a whole"
                " fraction of that"
            )
        self._selector = Selector(SelectorCfg(spec.beta, spec.gamma, spec.rate_hz), num_robots)
        self._trusted = np.ones(num_robots, bool)
        self._calls = 0

    @property
    def probability(self) -> np.ndarray:
        """Vision probability P_t, [N]."""
        return self._selector.probability

    def update(self, anomaly_score: np.ndarray, frames: Frames) -> np.ndarray:
        """See `Switch.update`; the selector acts at the end of each of its own periods."""
        self._calls += 1
        if self._calls % self._every == 0:
            self._trusted = self._selector.update(anomaly_score)
        return self._trusted

    def reset(self, mask: np.ndarray) -> None:
        """See `Switch.reset`."""
        self._selector.reset(mask)
        self._trusted = self._trusted | mask
