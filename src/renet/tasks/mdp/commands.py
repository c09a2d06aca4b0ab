"""The goal: a forward speed c_x and a world yaw c_yaw, sampled at random (RENet, Method C)."""

import math
from dataclasses import dataclass

import torch
from mjlab.entity import Entity
from mjlab.envs import ManagerBasedRlEnv
from mjlab.managers.command_manager import CommandTerm, CommandTermCfg
from mjlab.utils.lab_api.math import wrap_to_pi
from torch import Tensor

from renet.tasks.mdp.base_state import base_heading

COMMAND = "goal"
"""Name of the command term in every RENet task."""


@dataclass(kw_only=True)
class GoalCommandCfg(CommandTermCfg):
    """How goals are drawn."""

    resampling_time_range: tuple[float, float] = (2.0, 8.0)
    """Seconds between goals. Most robots have left their tile after 7 s: with later changes they
    learn to stand, but not to stop."""
    speed: tuple[float, float] = (0.2, 1.0)
    """Range of c_x in m/s at stage 0 (paper's first level)."""
    later_speed: tuple[float, float] = (0.0, 1.0)
    """Range of c_x at stage 1 (paper's second level)."""
    standing_share: float = 0.3
    """Share of stage 1's redrawn goals with c_x = 0: a uniform draw alone would never ask for it.
    None at an episode's start: to stop is harder than to stand."""
    slowest: float = 0.1
    """At stage 1 a smaller c_x is set to 0, m/s: eq. 6 divides by c_x, and sensor noise hides
    slower motion."""
    first_turn: float = math.pi / 2
    """|c_yaw - yaw| at an episode's start is uniform up to this, rad."""
    later_turn: float = math.pi / 3
    """Largest change of c_yaw when a goal is redrawn, rad: a robot on a tile keeps leaving it."""
    fixed_speed: float | None = None
    """c_x for evaluation, m/s; c_yaw then stays each robot's starting yaw."""

    def build(self, env: ManagerBasedRlEnv) -> "GoalCommand":
        return GoalCommand(self, env)


class GoalCommand(CommandTerm):
    """Holds c_x and c_yaw; `command` is (c_x, sin e, cos e) with e = c_yaw - yaw, [N, 3]."""

    cfg: GoalCommandCfg

    def __init__(self, cfg: GoalCommandCfg, env: ManagerBasedRlEnv) -> None:
        super().__init__(cfg, env)
        self.robot: Entity = env.scene["robot"]
        self.stage = 0
        """0: walk only; 1: standing still is asked for too (paper's two-level curriculum)."""
        self.standing_time = 1.0
        """Share of other goals' time after which one to stand is replaced."""
        self.speed = torch.zeros(self.num_envs, device=self.device)
        """c_x, [N] m/s."""
        self.yaw = torch.zeros(self.num_envs, device=self.device)
        """c_yaw, [N] rad, world frame."""
        self.commanded_distance = torch.zeros(self.num_envs, device=self.device)
        """Integral of c_x over the episode so far, [N] m."""
        self._command = torch.zeros(self.num_envs, 3, device=self.device)

    @property
    def command(self) -> Tensor:
        """(c_x, sin e, cos e) with e = c_yaw - yaw, [N, 3]."""
        return self._command

    @property
    def heading_error(self) -> Tensor:
        """c_yaw - yaw, wrapped to [-pi, pi], [N] rad."""
        error = self.yaw - base_heading(self._env)
        return (error + math.pi) % (2.0 * math.pi) - math.pi

    @property
    def direction(self) -> Tensor:
        """n_yaw = (cos c_yaw, sin c_yaw), [N, 2] (RENet eq. 6)."""
        return torch.stack((self.yaw.cos(), self.yaw.sin()), dim=-1)

    def reset(self, env_ids: Tensor | slice | None) -> dict[str, float]:
        """Begin episodes with new goals."""
        self.commanded_distance[env_ids] = 0.0
        return super().reset(env_ids)

    def compute(self, dt: float | Tensor, env_ids: Tensor | None = None) -> None:
        """Let time pass and redraw goals whose time is up.

        Args:
            dt: seconds since the last call; a tensor [N] is zero for robots that begin an episode.
            env_ids: robots to compute, by default all.
        """
        if env_ids is None:
            self.commanded_distance += self.speed * dt
        super().compute(dt, env_ids)

    def _resample_command(self, env_ids: Tensor) -> None:
        def uniform(low: float, high: float) -> Tensor:
            return torch.empty(len(env_ids), device=self.device).uniform_(low, high)

        cfg, begins = self.cfg, self.command_counter[env_ids] == 0
        turn = torch.where(begins, cfg.first_turn, cfg.later_turn) * uniform(-1.0, 1.0)
        if cfg.fixed_speed is not None:
            speed, turn = torch.full_like(turn, cfg.fixed_speed), torch.zeros_like(turn)
        elif self.stage == 0:
            speed = uniform(*cfg.speed)
        else:
            speed = uniform(*cfg.later_speed)
            stands = (uniform(0.0, 1.0) < cfg.standing_share) & ~begins
            stands |= speed < cfg.slowest
            speed *= ~stands
            self.time_left[env_ids] *= torch.where(stands, self.standing_time, 1.0)
        self.speed[env_ids] = speed
        around = torch.where(begins, self._written_heading(env_ids), self.yaw[env_ids])
        self.yaw[env_ids] = wrap_to_pi(around + turn)

    def _written_heading(self, env_ids: Tensor) -> Tensor:
        """Yaw of the pose that a reset wrote, which kinematics have not seen yet, rad."""
        address = self.robot.indexing.free_joint_q_adr[3:7]
        w, x, y, z = self._env.sim.data.qpos[env_ids[:, None], address].unbind(-1)
        return torch.atan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z))

    def _update_command(self, env_ids: Tensor | None) -> None:
        error = self.yaw - base_heading(self._env)
        self._command = torch.stack((self.speed, error.sin(), error.cos()), dim=-1)

    def _update_metrics(self) -> None: ...


def goal(env: ManagerBasedRlEnv) -> GoalCommand:
    """The task's command term."""
    return env.command_manager.get_term(COMMAND)  # type: ignore[return-value]
