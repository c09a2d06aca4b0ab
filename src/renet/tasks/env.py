"""mjlab's environment, with fused physics steps on the CPU."""

import gc
import math
from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, field
from functools import partial
from importlib import import_module

import torch
from mjlab.actuator import BuiltinPositionActuatorCfg
from mjlab.envs import ManagerBasedRlEnv, ManagerBasedRlEnvCfg
from mjlab.sensor import ContactSensorCfg
from mjlab.sim.sim import Simulation
from mjlab.tasks.registry import list_tasks, load_env_cfg
from torch import Tensor

from renet.errors import RenetError, unknown_name
from renet.motor_models import find_motors
from renet.options import check_seed
from renet.robots import Robot
from renet.sim.motors import Motors
from renet.sim.native.engine import use_engine
from renet.sim.threads import one_torch_thread
from renet.tasks.entity import VISUAL_GO1
from renet.tasks.motor_models import use_motors
from renet.tasks.motors import MotorsCfg, RandomMotors


@dataclass(kw_only=True)
class RenetEnvCfg(ManagerBasedRlEnvCfg):
    """mjlab's configuration of an environment, with the robot and its motors."""

    robot: Robot = VISUAL_GO1
    """Robot in the scene; `renet export` writes its gains and pose into a bundle."""
    motors: MotorsCfg = field(default_factory=MotorsCfg)
    """Model of the motors, delays of joint targets, and torque–speed curves."""

    def __post_init__(self) -> None:
        # False for NaN, too.
        if not self.episode_length_s > 0.0:
            raise RenetError(f"episode_length_s must be above 0, got {self.episode_length_s}")


class RenetEnv(ManagerBasedRlEnv):
    """mjlab's environment, which is faster on the native CPU engine."""

    cfg: RenetEnvCfg

    def __init__(self, cfg: RenetEnvCfg, device: str, render_mode: str | None = None) -> None:
        # A copy: motors and decimation change below, and callers reuse configurations.
        own_cfg = deepcopy(cfg)
        motors = find_motors(cfg.motors.model, cfg.robot.name)
        use_motors(own_cfg.scene.entities["robot"], own_cfg.motors, motors)
        super().__init__(own_cfg, device, render_mode)
        self.task_cfg = cfg
        """Configuration as the caller gave it."""
        self.motors = self._make_motors()
        """Delays and torque–speed curves, or None for ideal motors."""
        self._substeps = 1
        # The native engine takes all physics steps of a control step in one call. That gives the
        # same result if servos hold their target, and no term reads the states in between.
        if hasattr(self.sim, "step_n") and not _reads_substeps(self.cfg):
            self._substeps = self.cfg.decimation
            self.cfg.decimation = 1
            self.sim.step = partial(self.sim.step_n, self._substeps)  # type: ignore[method-assign]
            self.sim.forward = self.sim.forward_written  # type: ignore[method-assign]
            if self.motors is not None:
                self.sim.use_motors(self.motors)
        elif self.motors is not None:
            self.sim.step = partial(_step_with_motors, self.sim, self.motors, self.sim.step)

    def _make_motors(self) -> RandomMotors | None:
        """Build the configured motors; None for ideal ones."""
        cfg = self.cfg.motors
        if cfg.ideal:
            return None
        # With torque–speed curves each robot needs force limits of its own.
        if cfg.no_load_speed is not None and "actuator_forcerange" not in self.sim.expanded_fields:
            self.sim.expand_model_fields(("actuator_forcerange",))
        return RandomMotors(cfg, self.sim, self.cfg.robot, self.num_envs, self.cfg.decimation)

    def _reset_idx(self, env_ids: Tensor | None = None) -> None:
        super()._reset_idx(env_ids)
        if self.motors is None:
            return
        if env_ids is None:
            env_ids = torch.arange(self.num_envs, device=self.device)
        self.motors.begin_episodes(env_ids)

    @property
    def physics_dt(self) -> float:
        """Duration of a call of `sim.step`, s."""
        return self.cfg.sim.mujoco.timestep * getattr(self, "_substeps", 1)

    @property
    def step_dt(self) -> float:
        """Duration of a control step, s."""
        return self.physics_dt * self.cfg.decimation

    def step(self, action: Tensor):
        """Take a control step, on one thread of torch: its operations are too small for more."""
        with one_torch_thread(self.device):
            return super().step(action)


def _step_with_motors(sim: Simulation, motors: Motors, step: Callable[[], None]) -> None:
    """Take a physics step with motors that are not ideal."""
    motors.drive(sim)
    step()


def _reads_substeps(cfg: RenetEnvCfg) -> bool:
    """Return True if an actuator, a sensor or a metric of a task works at the physics rate."""
    for entity in cfg.scene.entities.values():
        if not entity.articulation:
            continue
        for actuator in entity.articulation.actuators:
            if not isinstance(actuator, BuiltinPositionActuatorCfg) or actuator.delay_max_lag:
                return True
    for sensor in cfg.scene.sensors:
        is_contact = isinstance(sensor, ContactSensorCfg)
        if is_contact and (sensor.track_air_time or sensor.history_length):
            return True
    return any(metric.per_substep for metric in cfg.metrics.values())


def make_env(
    task: str | RenetEnvCfg, num_envs: int, device: str = "cpu", seed: int = 1, engine: str = "auto"
) -> RenetEnv:
    """Build a task's environment.

    Args:
        task: Id of a task, or a configuration, which is not changed.
        num_envs: Number of robots.
        device: Device of the simulation.
        seed: Seed of all random numbers.
        engine: auto, native or warp (see renet.sim.native.engine).

    Raises:
        RenetError: The task or engine is unknown, or a setting is out of range.
    """
    if num_envs < 1:
        raise RenetError(f"the number of environments must be at least 1, got {num_envs}")
    check_seed(seed)
    cfg = env_cfg(task) if isinstance(task, str) else deepcopy(task)
    for name, term in cfg.rewards.items():
        if not math.isfinite(term.weight):
            raise RenetError(f"the weight of the reward {name} is {term.weight}: give a number")
    cfg.scene.num_envs = num_envs
    cfg.seed = seed
    # Free earlier environments, which are few objects with much memory and circular references.
    gc.collect()
    with use_engine(engine, device):
        return RenetEnv(cfg, device)


def env_cfg(task: str, play: bool = False) -> RenetEnvCfg:
    """Return a copy of a registered task's configuration.

    Args:
        task: Id of the task.
        play: Return the variant for evaluation, without noise, pushes and curriculum.

    Raises:
        RenetError: There is no such task, or it is not one of RENet's.
    """
    import mjlab.tasks  # noqa: F401  Registers the tasks of all plug-ins.

    # The entry point does the same, which a source tree without installation lacks.
    import_module("renet.registry")
    if task not in list_tasks():
        raise unknown_name("task", task, [n for n in list_tasks() if n.startswith("Renet")])
    cfg = load_env_cfg(task, play)
    if not isinstance(cfg, RenetEnvCfg):
        raise RenetError(f"{task} is not a RENet task: it defines no constraint costs")
    return cfg


def stored_env_cfg(task: str) -> RenetEnvCfg:
    """Return the configuration of the task that a checkpoint states (see `env_cfg`).

    Raises:
        RenetError: There is no such task here: programs of users register tasks, too.
    """
    try:
        return env_cfg(task)
    except RenetError as error:
        raise RenetError(
            f"the checkpoint's task {task[:60]} is unknown here: run the program that registers it "
            "in place of renet (docs/extend.md)"
        ) from error
