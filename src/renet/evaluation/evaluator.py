"""Evaluator of studies: a bundle, its policy and selector, and environments for them."""

import dataclasses
import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from mjlab.terrains import TerrainEntityCfg

from renet.bundle import Bundle
from renet.errors import RenetError
from renet.evaluation.conditions import use_training_conditions
from renet.evaluation.env import (
    SimEnv,
    study_env_cfg,
    terrain_env_cfg,
    trained_env_cfg,
)
from renet.evaluation.results import Provenance
from renet.evaluation.rollout import EvalEnv, Rollout, Trial, pilot_modes
from renet.evaluation.settings import FLAT_GROUND, PARKOUR, Conditions
from renet.interface import Unseen
from renet.motor_models import IDEAL, find_motors
from renet.pilot import Pilot
from renet.pilot.pilot import Selector
from renet.pilot.policy import BundlePolicy, Policy
from renet.robots import Robot
from renet.selector import make_selector
from renet.sim.threads import THREADS
from renet.tasks import RenetEnvCfg
from renet.tasks.sensors import depth_camera

StudyTerrain = str | Mapping[str, int] | TerrainEntityCfg
"""Terrain by name, level of each ground by kind, or any field of tiles; see `terrain_env_cfg`."""
Task = StudyTerrain | RenetEnvCfg
"""Terrain, or the configuration of a whole task."""


class Evaluator:
    """Bundle under study; a subclass for another policy overrides `make_policy`."""

    privileged: tuple[str, ...] = ()
    """Groups of privileged observations that the policy reads from `SimEnv.observation`."""

    def __init__(
        self,
        bundle: Path | None = None,
        engine: str = "auto",
        conditions: Conditions = "training",
        motors: str = IDEAL,
    ) -> None:
        """Load a bundle; raises RenetError if the bundle or the motors cannot be used.

        Args:
            bundle: Folder of the bundle; by default the one that comes with renet.
            engine: Name of the physics engine: auto, native or warp.
            conditions: Name of the conditions: training, those of the bundle's task, or nominal.
            motors: Motors of the robots: ideal, go1, or a file of `renet identify`.
        """
        self.bundle = Bundle.load(bundle, threads=THREADS)
        self.engine = engine
        self.conditions = conditions
        self.motors = motors
        """Name or file of the robots' motors."""
        # Wrong motors are refused before a study begins.
        find_motors(motors, self.bundle.manifest.robot.name)

    @property
    def robot(self) -> Robot:
        """The robot the bundle was trained on; raises RenetError if it is unknown here."""
        return trained_env_cfg(self.bundle.manifest).robot

    @property
    def beta(self) -> float:
        """Threshold of mode memory on the reconstruction's anomaly score."""
        spec = self.bundle.manifest.selector
        return spec.thresholds.get("reconstruction", spec.beta)

    @property
    def paper_beta(self) -> float:
        """Threshold of mode switch on the anomaly score, the paper's β."""
        return self.bundle.manifest.selector.beta

    @property
    def thresholds(self) -> dict[str, float]:
        """Thresholds of the monitors of mode memory, by name."""
        return self.bundle.manifest.selector.used_thresholds

    @property
    def training_sha256(self) -> str:
        """Hexadecimal SHA-256 of the robot, the camera and the task that the bundle was trained on.

        Environments are made from them, and `Bundle.sha256` leaves them out.
        """
        manifest = self.bundle.manifest
        parts = [dataclasses.asdict(manifest.robot), dataclasses.asdict(manifest.camera)]
        content = json.dumps([*parts, manifest.provenance.task, manifest.told], sort_keys=True)
        return hashlib.sha256(content.encode()).hexdigest()

    def provenance(self, seed: int) -> Provenance:
        """Return the provenance of numbers that are made with this bundle now."""
        engine = "native" if self.engine == "auto" else self.engine
        return Provenance(self.bundle.name, self.bundle.sha256, engine, seed)

    def terrain_env_cfg(self, terrain: StudyTerrain) -> RenetEnvCfg:
        """Return `env.terrain_env_cfg` for the bundle's robot, in the evaluator's conditions."""
        cfg = terrain_env_cfg(terrain, self.robot)
        self.set_conditions(cfg)
        return cfg

    def set_conditions(self, cfg: RenetEnvCfg) -> None:
        """Set a task to the evaluator's conditions, in place."""
        if self.conditions == "training":
            use_training_conditions(cfg, trained_env_cfg(self.bundle.manifest))

    def make_env(
        self,
        task: Task,
        robots: Sequence[int],
        speed: float,
        seed: int,
        camera_noise: float | None = None,
    ) -> SimEnv:
        """Make an environment of robots that are commanded to walk straight ahead.

        Args:
            task: Terrain or grounds as in `terrain_env_cfg`, or a task made with `play=True`, whose
                conditions are not changed (see `set_conditions`).
            robots: A number for each robot; robots with the same number are twins.
            speed: Commanded speed, m/s.
            seed: Seed of bodies and starts.
            camera_noise: Standard deviation of every depth, m; None: as in the bundle's training.

        Raises:
            RenetError: The task's robot is not the bundle's, or the seed is out of range.
        """
        # NumPy's legacy generator takes no other seeds.
        if not 0 <= seed < 2**32:
            raise RenetError(f"seed must be from 0 to 2^32 - 1, got {seed}")
        # Any other string is the id of a task.
        if isinstance(task, Mapping | TerrainEntityCfg) or (
            isinstance(task, str) and task in (FLAT_GROUND, PARKOUR)
        ):
            task = self.terrain_env_cfg(task)
        cfg = study_env_cfg(task, speed, self.privileged, self.bundle.manifest.told)
        robot = self.bundle.manifest.robot.name
        if robot != cfg.robot.name:
            raise RenetError(
                f"bundle {self.bundle.name} drives a {robot}, this task's robot is a"
                f" {cfg.robot.name}: give a --bundle trained on the {cfg.robot.name}"
            )
        # Depth images keep the noise of training, unless a study sets its own.
        if camera_noise is None:
            camera_noise = self.bundle.manifest.camera.noise_std
        depth_camera(cfg).noise.gaussian_std = camera_noise
        cfg.motors.model = self.motors
        self.env = SimEnv(cfg, robots, seed, self.engine)
        """The newest environment, for policies that need the simulator's truth."""
        return self.env

    def make_policy(self, num_robots: int) -> Policy:
        """Make the policy under study."""
        return BundlePolicy(self.bundle, num_robots)

    def make_selector(self, kind: str, num_robots: int) -> Selector:
        """Make the selector of mode memory or switch, for N robots."""
        return make_selector(kind, self.bundle.manifest.selector, num_robots)

    def rollout(
        self,
        env: EvalEnv,
        trials: Sequence[Trial],
        seed: int,
        unseen: Unseen | Sequence[Unseen] = "walk",
    ) -> Rollout:
        """Prepare a run of the policy under study.

        Args:
            env: Environment of N robots.
            trials: Mode and camera faults of each robot, [N].
            seed: Seed of the camera faults.
            unseen: Conduct where the camera fails, of all robots or of each, see `Pilot`.
        """
        modes = pilot_modes(trials)
        policy = self.make_policy(len(trials))
        # Robots of other modes obey no selector, but their traces record mode memory's answers.
        kinds = ["memory", "switch"] if "switch" in modes else ["memory"]
        selectors = {kind: self.make_selector(kind, len(trials)) for kind in kinds}
        return Rollout(env, Pilot(policy, selectors, modes, unseen), trials, seed)
