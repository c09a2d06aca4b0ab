"""What every study works with: a bundle, its policy and selector, and environments for them."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from mjlab.terrains import TerrainEntityCfg

from renet.bundle import Bundle
from renet.errors import RenetError
from renet.evaluation.conditions import as_trained
from renet.evaluation.env import (
    SimEnv,
    robot_of,
    study_env_cfg,
    terrain_env_cfg,
    trained_env_cfg,
)
from renet.evaluation.results import Provenance
from renet.evaluation.rollout import (
    FLAT,
    PARKOUR,
    Conditions,
    EvalEnv,
    Rollout,
    Trial,
    pilot_modes,
)
from renet.interface import Unseen
from renet.motor_models import IDEAL, find_motors
from renet.pilot import Pilot
from renet.pilot.pilot import Selector
from renet.pilot.policy import BundlePolicy, Policy
from renet.robots import Robot
from renet.selector import make_selector
from renet.sim.threads import THREADS
from renet.tasks import RenetEnvCfg
from renet.tasks.motor_models import use_motors
from renet.tasks.sensors import depth_camera

Terrain = str | Mapping[str, int] | TerrainEntityCfg
Task = Terrain | RenetEnvCfg


class Evaluator:
    """One bundle under study; a subclass for another policy overrides `make_policy`."""

    privileged: tuple[str, ...] = ()
    """Groups of training's observations that the policy reads from `SimEnv.observation`."""

    def __init__(
        self,
        bundle: Path | None = None,
        engine: str = "auto",
        conditions: Conditions = "nominal",
        motors: str = IDEAL,
    ) -> None:
        """Load a bundle; raises RenetError where it or motors cannot be used.

        Args:
            bundle: its folder; the one that ships with renet by default.
            engine: auto, native or warp.
            conditions: nominal, or training: those of the bundle's task.
            motors: of the robots: ideal, go1, or a file of `renet identify`.
        """
        self.bundle = Bundle.load(bundle, threads=THREADS)
        self.engine = engine
        self.conditions = conditions
        self.motors = find_motors(motors, self.bundle.manifest.robot.name)
        """Motors of the robots; None: ideal ones."""

    @property
    def robot(self) -> Robot:
        """The robot the bundle was trained on; raises RenetError if it is unknown here."""
        return robot_of(self.bundle.manifest)

    @property
    def beta(self) -> float:
        """Threshold on the anomaly score of the mode `memory`."""
        spec = self.bundle.manifest.selector
        return spec.thresholds.get("reconstruction", spec.beta)

    @property
    def paper_beta(self) -> float:
        """Threshold on the anomaly score of the mode `switch`."""
        return self.bundle.manifest.selector.beta

    @property
    def thresholds(self) -> dict[str, float]:
        """Thresholds of the monitors of the mode `memory`, by name."""
        return self.bundle.manifest.selector.used_thresholds

    def provenance(self, seed: int) -> Provenance:
        """The provenance of numbers made with this bundle now."""
        engine = "native" if self.engine == "auto" else self.engine
        return Provenance(self.bundle.name, self.bundle.sha256, engine, seed)

    def terrain_env_cfg(self, terrain: Terrain) -> RenetEnvCfg:
        """`env.terrain_env_cfg` with the bundle's robot, under the evaluator's conditions."""
        cfg = terrain_env_cfg(terrain, self.robot)
        self.set_conditions(cfg)
        return cfg

    def set_conditions(self, cfg: RenetEnvCfg) -> None:
        """Let robots of a configuration meet the evaluator's conditions."""
        if self.conditions == "training":
            as_trained(cfg, trained_env_cfg(self.bundle.manifest))

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
            task: terrain or grounds as in `terrain_env_cfg`, or a configuration made with
                `play=True`, whose conditions are its own (see `set_conditions`); raises RenetError
                if it is another robot's than the bundle.
            robots: one number for each robot; those with the same number are twins.
            speed: commanded, m/s. seed: of bodies and starts.
            camera_noise: standard deviation of every depth, m; None: that of the bundle's training.
        """
        if not 0 <= seed < 2**32:
            raise RenetError(f"seed must be from 0 to 2^32 - 1, got {seed}")
        if isinstance(task, Mapping | TerrainEntityCfg) or (
            isinstance(task, str) and task in (FLAT, PARKOUR)
        ):
            task = self.terrain_env_cfg(task)
        cfg = study_env_cfg(task, speed, self.privileged, self.bundle.manifest.told)
        robot = self.bundle.manifest.robot.name
        if robot != cfg.robot.name:
            raise RenetError(
                f"bundle {self.bundle.name} drives a {robot}, this task's robot is a"
                f" {cfg.robot.name}: give a --bundle trained on the {cfg.robot.name}"
            )
        if camera_noise is None:
            camera_noise = self.bundle.manifest.camera.noise_std
        depth_camera(cfg).noise.gaussian_std = camera_noise
        use_motors(cfg, self.motors)
        self.env = SimEnv(cfg, robots, seed, self.engine)
        """The newest environment, for policies that need the simulator's truth."""
        return self.env

    def make_policy(self, num_robots: int) -> Policy:
        """Make the policy under study."""
        return BundlePolicy(self.bundle, num_robots)

    def make_selector(self, kind: str, num_robots: int) -> Selector:
        """Make what robots of the mode `memory` or `switch` obey."""
        return make_selector(kind, self.bundle.manifest.selector, num_robots)

    def make_pilot(self, modes: Sequence[str], unseen: Unseen | Sequence[Unseen] = "walk") -> Pilot:
        """Make the pilot of the policy under study, with the mode and the conduct of each robot."""
        robots = len(modes)
        policy = self.make_policy(robots)
        # Robots of other modes obey none, but their traces tell what `memory` would do.
        kinds = ["memory", "switch"] if "switch" in modes else ["memory"]
        selectors = {kind: self.make_selector(kind, robots) for kind in kinds}
        return Pilot(policy, selectors, modes, unseen)

    def rollout(
        self,
        env: EvalEnv,
        trials: Sequence[Trial],
        seed: int,
        unseen: Unseen | Sequence[Unseen] = "walk",
    ) -> Rollout:
        """Prepare a run of the policy under study; see `Rollout` and, for `unseen`, `Pilot`."""
        return Rollout(env, self.make_pilot(pilot_modes(trials), unseen), trials, seed)
