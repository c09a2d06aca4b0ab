"""mjlab's environment with fused physics steps on the CPU."""

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
from renet.sim.motors import Motors
from renet.sim.native.engine import use_engine
from renet.sim.threads import one_torch_thread
from renet.tasks.config.go1 import GO1
from renet.tasks.motors import DrawnMotors, MotorsCfg
from renet.tasks.robot_cfg import RobotCfg


@dataclass(kw_only=True)
class RenetEnvCfg(ManagerBasedRlEnvCfg):
    """ManagerBasedRlEnvCfg that knows its robot."""

    robot: RobotCfg = GO1
    """The robot in the scene; `renet export` writes its gains and pose into a bundle."""
    motors: MotorsCfg = field(default_factory=MotorsCfg)
    """How late its joint targets are, and how its torque falls with speed."""


class RenetEnv(ManagerBasedRlEnv):
    """mjlab's environment, quicker on the native CPU engine."""

    cfg: RenetEnvCfg

    def __init__(self, cfg: RenetEnvCfg, device: str, render_mode: str | None = None) -> None:
        # A copy: this environment's decimation changes below, and callers reuse configurations.
        super().__init__(deepcopy(cfg), device, render_mode)
        self.task_cfg = cfg
        """The configuration as it was given."""
        self.motors = self._make_motors()
        """Delays and torque–speed curves; None: motors are ideal."""
        self._substeps = 1
        # The native engine takes all substeps of a control step in one call, poses included, where
        # it changes nothing: servos hold their target and nobody looks in between.
        if hasattr(self.sim, "step_n") and not _looks_at_substeps(self.cfg):
            self._substeps, self.cfg.decimation = self.cfg.decimation, 1
            self.sim.step = partial(self.sim.step_n, self._substeps)  # type: ignore[method-assign]
            self.sim.forward = self.sim.forward_written  # type: ignore[method-assign]
            if self.motors is not None:
                self.sim.use_motors(self.motors)
        elif self.motors is not None:
            self.sim.step = partial(_driven_step, self.sim, self.motors, self.sim.step)

    def _make_motors(self) -> DrawnMotors | None:
        """The motors of the configuration, unless they are ideal."""
        cfg = self.cfg.motors
        if cfg.ideal:
            return None
        if cfg.no_load_speed is not None and "actuator_forcerange" not in self.sim.expanded_fields:
            self.sim.expand_model_fields(("actuator_forcerange",))
        return DrawnMotors(cfg, self.sim, self.cfg.robot, self.num_envs, self.cfg.decimation)

    def _reset_idx(self, env_ids: Tensor | None = None) -> None:
        super()._reset_idx(env_ids)
        if self.motors is not None:
            everybody = torch.arange(self.num_envs, device=self.device)
            self.motors.begin_episodes(everybody if env_ids is None else env_ids)

    @property
    def physics_dt(self) -> float:
        """Seconds per call of `sim.step`."""
        return self.cfg.sim.mujoco.timestep * getattr(self, "_substeps", 1)

    @property
    def step_dt(self) -> float:
        """Seconds per control step."""
        return self.physics_dt * self.cfg.decimation

    def step(self, action: Tensor):
        """Take a control step; torch's operations are too small for more than one thread."""
        with one_torch_thread(self.device):
            return super().step(action)


def _driven_step(sim: Simulation, motors: Motors, step: Callable[[], None]) -> None:
    """Take a physics step with motors that are not ideal."""
    motors.drive(sim)
    step()


def _looks_at_substeps(cfg: RenetEnvCfg) -> bool:
    """Whether an actuator delay, an air-time sensor or a metric runs at the physics rate."""
    bodies = [e.articulation for e in cfg.scene.entities.values() if e.articulation]
    servos = [actuator for body in bodies for actuator in body.actuators]
    contacts = [s for s in cfg.scene.sensors if isinstance(s, ContactSensorCfg)]
    return (
        any(not isinstance(s, BuiltinPositionActuatorCfg) or s.delay_max_lag for s in servos)
        or any(sensor.track_air_time or sensor.history_length for sensor in contacts)
        or any(metric.per_substep for metric in cfg.metrics.values())
    )


def make_env(
    task: str | RenetEnvCfg, num_envs: int, device: str = "cpu", seed: int = 1, engine: str = "auto"
) -> RenetEnv:
    """Build a task's environment; raises RenetError for an unknown task or engine.

    Args:
        task: task id, or a configuration, which is left as it is.
        engine: auto, native or warp (see renet.sim.native.engine).
    """
    if num_envs < 1:
        raise RenetError(f"the number of environments must be at least 1, got {num_envs}")
    cfg = env_cfg(task) if isinstance(task, str) else deepcopy(task)
    for name, term in cfg.rewards.items():
        if not math.isfinite(term.weight):
            raise RenetError(f"the weight of the reward {name} is {term.weight}: give a number")
    cfg.scene.num_envs = num_envs
    cfg.seed = seed
    gc.collect()  # Earlier environments: few objects with much memory that refer to one another.
    with use_engine(engine, device):
        return RenetEnv(cfg, device)


def env_cfg(task: str, play: bool = False) -> RenetEnvCfg:
    """A copy of a registered RENet task's configuration; raises RenetError if there is none.

    With `play` it is the evaluation variant, without noise, pushes and curriculum.
    """
    import mjlab.tasks  # noqa: F401  registers every plug-in's tasks

    import_module("renet.registry")  # As its entry point does, which a bare source tree lacks.
    if task not in list_tasks():
        raise unknown_name("task", task, [n for n in list_tasks() if n.startswith("Renet")])
    cfg = load_env_cfg(task, play)
    if not isinstance(cfg, RenetEnvCfg):
        raise RenetError(f"{task} is not a RENet task: it defines no constraint costs")
    return cfg
