"""What every study works with: a bundle, its policy and selector, and worlds to put them in."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import mujoco
import warp as wp

from renet.deploy.bundle import Bundle
from renet.deploy.policy import Policy
from renet.errors import RenetError
from renet.evaluation.results import Provenance
from renet.evaluation.rollout import Controller, Row, Switch, World, run_rollout
from renet.evaluation.switches import check_selector, make_switch
from renet.evaluation.terminal import progress
from renet.evaluation.trace import Trace
from renet.evaluation.world import SimWorld, study_env_cfg
from renet.selector.monitors import SelectorInput, default_monitors
from renet.tasks import RenetEnvCfg


class Lab:
    """One bundle under study; a third party's policy overrides `controller` and `switch`."""

    def __init__(
        self, bundle: Path | None = None, engine: str = "auto", selector: str = "monitors"
    ) -> None:
        """Load a bundle.

        Args:
            bundle: its folder; the one that ships with renet by default.
            engine: auto, native or warp.
            selector: monitors, which is all monitors with a dwell, or paper.

        Raises:
            RenetError: a missing, damaged or incompatible bundle, or an unknown selector.
        """
        check_selector(selector)
        wp.config.quiet = True
        self.bundle = Bundle.load(bundle, threads=2)
        self.engine, self.selector = engine, selector
        self.scene_spec: mujoco.MjSpec | None = None
        """The scene of the latest world, for pictures."""

    @property
    def beta(self) -> float:
        """The selector's threshold on the anomaly score: the paper's, or the calibrated one."""
        spec = self.bundle.manifest.selector
        calibrated = spec.thresholds.get("reconstruction", spec.beta)
        return spec.beta if self.selector == "paper" else calibrated

    @property
    def thresholds(self) -> dict[str, float]:
        """Thresholds of the default selector's monitors, by name."""
        spec = self.bundle.manifest.selector
        return {m.name: m.threshold for m in default_monitors(spec.beta, spec.thresholds, 1)}

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

        Raises:
            RenetError: the bundle is another robot's than the task's.
        """
        cfg = study_env_cfg(task, speed)
        self._check_robot(cfg.robot.name)
        world = SimWorld(cfg, robots, seed, self.engine)
        self.scene_spec = world.scene_spec
        return world

    def _check_robot(self, name: str) -> None:
        """Raise RenetError unless the bundle is of this robot."""
        own = self.bundle.manifest.robot.name
        if own != name:
            raise RenetError(
                f"bundle {self.bundle.name} drives a {own}, this task's robot is a {name}: give a"
                f" --bundle trained on the {name}"
            )

    def controller(self, num_robots: int) -> Controller:
        """The policy under study."""
        return Policy(self.bundle, num_robots)

    def switch(self, num_robots: int, selector: str | None = None) -> Switch:
        """The bundle's selector, or another one with its thresholds."""
        return make_switch(selector or self.selector, self.bundle.manifest.selector, num_robots)

    def walk(
        self,
        title: str,
        world: World,
        rows: Sequence[Row],
        steps: int,
        seed: int,
        film: Sequence[int] = (),
        on_step: Callable[[], Any] = lambda: None,
        on_sight: Callable[[SelectorInput], Any] = lambda sight: None,
    ) -> Trace:
        """Drive the policy under study beside a progress bar; see `run_rollout`."""
        with progress(title, steps) as advance:

            def after_step() -> Any:
                advance()
                return on_step()

            return run_rollout(
                world,
                self.controller(len(rows)),
                self.switch(len(rows)),
                rows,
                steps,
                seed,
                film,
                after_step,
                on_sight=on_sight,
            )
