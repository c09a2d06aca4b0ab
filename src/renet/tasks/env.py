"""mjlab's environment with constraint costs, a clipped reward and a resumable curriculum."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any

import torch
from mjlab.actuator import BuiltinPositionActuatorCfg
from mjlab.envs import ManagerBasedRlEnv, ManagerBasedRlEnvCfg
from mjlab.sensor import ContactSensorCfg
from mjlab.tasks.registry import list_tasks, load_env_cfg
from torch import Tensor

from renet.errors import RenetError
from renet.sim.native.engine import use_engine
from renet.sim.threads import one_torch_thread
from renet.tasks.commands import goal
from renet.tasks.constraints import ConstraintCfg
from renet.tasks.env_data import FloatingBase
from renet.tasks.go1 import GO1
from renet.tasks.judge import Judge
from renet.tasks.managers import (
    DeviceCurriculum,
    StackedMetrics,
    StackedRewards,
    StackedTerminations,
)
from renet.tasks.observing import StackedObservations
from renet.tasks.robot import Robot
from renet.tasks.step import watch


@dataclass(kw_only=True)
class RenetEnvCfg(ManagerBasedRlEnvCfg):
    """ManagerBasedRlEnvCfg plus what RENet's constrained problem needs."""

    robot: Robot = GO1
    """Whose limits the constraints are, and what `renet export` writes into a bundle."""
    constraints: ConstraintCfg = field(default_factory=ConstraintCfg)
    clip_reward: bool = True
    """Keep each step's summed reward at or above zero (Extreme Parkour does): dying early never
    pays."""


class RenetEnv(ManagerBasedRlEnv):
    """Adds `extras["costs"]`: [N, 3], order of interface.CONSTRAINTS, times the step's dt."""

    cfg: RenetEnvCfg
    reward_manager: StackedRewards
    termination_manager: StackedTerminations
    metrics_manager: StackedMetrics

    def __init__(self, cfg: RenetEnvCfg, device: str, render_mode: str | None = None) -> None:
        # A copy: this environment's decimation changes below, and callers reuse configurations.
        cfg = deepcopy(cfg)
        super().__init__(cfg, device, render_mode)
        self._fuse_substeps()
        robot = self.scene["robot"]
        robot._data = FloatingBase(robot.data)

    def _fuse_substeps(self) -> None:
        """Let the native engine take all substeps of a control step in one call, poses included.

        Done only where it changes nothing: servos hold their target and nobody looks in between.
        """
        self._substeps = 1
        if hasattr(self.sim, "step_n") and not _looks_at_substeps(self.cfg):
            self._substeps, self.cfg.decimation = self.cfg.decimation, 1
            self.sim.step = partial(self.sim.step_n, self._substeps)  # type: ignore[method-assign]
            self.sim.forward = self.sim.forward_written  # type: ignore[method-assign]

    @property
    def physics_dt(self) -> float:
        """Seconds per call of `sim.step`."""
        return self.cfg.sim.mujoco.timestep * getattr(self, "_substeps", 1)

    @property
    def step_dt(self) -> float:
        """Seconds per control step."""
        return self.physics_dt * self.cfg.decimation

    def step(self, action: Tensor):
        """See ManagerBasedRlEnv.step."""
        with one_torch_thread(self.device):
            observation, reward, terminated, truncated, extras = super().step(action)
        extras["costs"] = self.costs
        if self.cfg.clip_reward:
            reward = reward.clamp_min(0.0)
        return observation, reward, terminated, truncated, extras

    def load_managers(self) -> None:
        """Load the managers, and judge a step before they ask: before any reset."""
        super().load_managers()
        self.observation_manager = StackedObservations(self.cfg.observations, self)
        self.reward_manager = StackedRewards(
            self.cfg.rewards, self, scale_by_dt=self.cfg.scale_rewards_by_dt
        )
        self.termination_manager = StackedTerminations(self.cfg.terminations, self)
        self.metrics_manager = StackedMetrics(self.cfg.metrics, self)
        self.curriculum_manager = DeviceCurriculum(self.cfg.curriculum, self)
        self.judge = Judge(self)
        conclude = self.termination_manager.compute

        def judge_and_conclude() -> Tensor:
            self.judge()
            return conclude()

        self.termination_manager.compute = judge_and_conclude  # type: ignore[method-assign]

    def _reset_idx(self, env_ids: Tensor) -> None:
        super()._reset_idx(env_ids)
        self.judge.forget(env_ids)

    @property
    def episode_length_buf(self) -> Tensor:
        """Control steps of each robot's episode so far, [N]."""
        return self._episode_length

    @episode_length_buf.setter
    def episode_length_buf(self, value: Tensor) -> None:  # type: ignore[override]
        # Runners assign one of their own, but the judge reads the first.
        if not hasattr(self, "_episode_length"):
            self._episode_length = value
        elif value is not self._episode_length:
            self._episode_length[:] = value

    @cached_property
    def watched(self) -> Any:
        """What terms in Warp read."""
        return watch(self)

    @property
    def costs(self) -> Tensor:
        """Of the last step, [N, 3]; see `extras["costs"]`."""
        return self.judge.costs

    # Checkpoints.

    def curriculum_state(self) -> dict[str, Tensor]:
        """Levels, command stage and step counter, for checkpoints."""
        state = {
            "command_stage": torch.tensor(goal(self).stage),
            "common_step_counter": torch.tensor(self.common_step_counter),
        }
        terrain = self.scene.terrain
        if terrain is not None and terrain.terrain_origins is not None:
            state |= {"levels": terrain.terrain_levels, "kinds": terrain.terrain_types}
        return state

    def load_curriculum_state(self, state: dict[str, Tensor]) -> None:
        """Restore `curriculum_state`; other numbers of robots on the tiles resample the levels."""
        goal(self).stage = int(state["command_stage"])
        self.common_step_counter = int(state["common_step_counter"])
        terrain = self.scene.terrain
        if terrain is None or terrain.terrain_origins is None or "levels" not in state:
            return
        levels, kinds = (state[name].to(self.device) for name in ("levels", "kinds"))
        if torch.equal(kinds, terrain.terrain_types):
            terrain.terrain_levels[:] = levels
        else:
            for kind in kinds.unique():
                here = terrain.terrain_types == kind
                pool = levels[kinds == kind]
                picks = torch.randint(len(pool), (int(here.sum()),), device=self.device)
                terrain.terrain_levels[here] = pool[picks]
        terrain.env_origins[:] = terrain.terrain_origins[
            terrain.terrain_levels, terrain.terrain_types
        ]


def _looks_at_substeps(cfg: RenetEnvCfg) -> bool:
    """Whether an actuator delay, an air-time sensor or a metric runs at the physics rate."""
    articulations = [entity.articulation for entity in cfg.scene.entities.values()]
    actuators = [
        a for articulation in articulations if articulation for a in articulation.actuators
    ]
    return (
        any(not isinstance(a, BuiltinPositionActuatorCfg) or a.delay_max_lag for a in actuators)
        or any(
            isinstance(s, ContactSensorCfg) and (s.track_air_time or s.history_length)
            for s in cfg.scene.sensors
        )
        or any(metric.per_substep for metric in cfg.metrics.values())
    )


def make_env(
    task: str | RenetEnvCfg,
    num_envs: int,
    device: str = "cpu",
    seed: int = 1,
    engine: str = "auto",
    play: bool = False,
) -> RenetEnv:
    """Build a task's environment.

    Args:
        task: task id, or a configuration, which is left as it is.
        engine: auto, native or warp (see renet.sim.native.engine).
        play: the task's evaluation variant, without noise, pushes and curriculum.

    Raises:
        RenetError: unknown task or engine, or no environment asked for.
    """
    if num_envs < 1:
        raise RenetError(f"the number of environments must be at least 1, got {num_envs}")
    cfg = env_cfg(task, play) if isinstance(task, str) else deepcopy(task)
    cfg.scene.num_envs = num_envs
    cfg.seed = seed
    with use_engine(engine, device):
        return RenetEnv(cfg, device)


def env_cfg(task: str, play: bool = False) -> RenetEnvCfg:
    """A copy of a registered RENet task's configuration; raises RenetError if there is none."""
    import mjlab.tasks  # noqa: F401  registers every plug-in's tasks

    if task not in list_tasks():
        known = [name for name in list_tasks() if name.startswith("Renet")]
        raise RenetError(f"unknown task {task!r}: choose one of {', '.join(known)}")
    cfg = load_env_cfg(task, play)
    if not isinstance(cfg, RenetEnvCfg):
        raise RenetError(f"{task} is not a RENet task: it defines no constraint costs")
    return cfg
