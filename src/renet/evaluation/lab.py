"""What every study works with: a bundle, its policy and selector, and worlds to put them in."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import warp as wp

from renet.deploy.bundle import Bundle
from renet.deploy.policy import Policy
from renet.evaluation.faults import Frames
from renet.evaluation.results import Provenance
from renet.evaluation.rollout import Controller, Switch
from renet.evaluation.world import SimWorld, study_env_cfg
from renet.tasks import RenetEnvCfg


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
        self.bundle = Bundle.load(bundle)
        self.engine = engine
        self.scene_spec: mujoco.MjSpec | None = None

    @property
    def beta(self) -> float:
        """The selector's threshold on the anomaly score."""
        return self.bundle.manifest.selector.beta

    def provenance(self, seed: int) -> Provenance:
        """Where numbers made with this bundle now come from."""
        return Provenance.now(self.bundle.name, self.bundle.sha256, self.engine, seed)

    def world(self, task: str | RenetEnvCfg, num_robots: int, speed: float, seed: int) -> SimWorld:
        """Robots that are told to walk straight ahead at `speed`, m/s."""
        world = SimWorld(study_env_cfg(task, speed), num_robots, seed, self.engine)
        self.scene_spec = world.scene_spec
        return world

    def controller(self, num_robots: int) -> Controller:
        """The policy under study."""
        return Policy(self.bundle, num_robots)

    def switch(self, num_robots: int, kind: str = "default") -> Switch:
        """The selector: "default" with all monitors, "paper" with the reconstruction loss alone."""
        return BundleSwitch(self.bundle, num_robots, kind)


class BundleSwitch:
    """The bundle's selector as a `Switch` of rollouts."""

    def __init__(self, bundle, num_robots: int, kind: str) -> None:
        self.probability = np.ones(num_robots)
        self.b = bundle.manifest.selector.beta

    def update(self, anomaly_score: np.ndarray, frames: Frames) -> np.ndarray:
        self.probability = 0.9 * self.probability + 0.1 * (anomaly_score < self.b)
        return self.probability > 0.5

    def reset(self, mask: np.ndarray) -> None:
        self.probability[mask] = 1
