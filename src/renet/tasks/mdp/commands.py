"""Where robots are to go: goals (RENet, Method C), and velocities in their own frames.

A goal is a forward speed c_x and a world yaw c_yaw, sampled at random. The paper's robots have
nothing else. The recipe's also follow velocities in any direction, as an operator steers them.
"""

import math
from dataclasses import dataclass, field

import torch
from mjlab.entity import Entity
from mjlab.envs import ManagerBasedRlEnv
from mjlab.managers.command_manager import CommandTerm, CommandTermCfg
from mjlab.utils.lab_api.math import wrap_to_pi
from torch import Tensor

from renet.errors import RenetError
from renet.interface import MAX_REVERSE, MAX_SIDEWAYS, MAX_SPEED, MAX_TURN, TURN_GAIN, Told
from renet.tasks.mdp.base_state import base_heading, base_velocity, on_tiles, rotated
from renet.terrain.tiles import Barrier

COMMAND = "goal"
"""Name of the command term in every RENet task."""
PLANE = "plane"
"""Ground without tiles."""
MAX_LAG = 0.5
"""Error of a velocity, as a share of it, beyond which a robot lags behind."""


def clear_widths(env: ManagerBasedRlEnv) -> list[float]:
    """Half-widths of the ground around the start, m, of each kind of tile; 0 of those without."""
    terrain = env.scene.terrain
    if terrain is None or terrain.cfg.terrain_generator is None:
        return []
    kinds = terrain.cfg.terrain_generator.sub_terrains.values()
    return [tile.clear if isinstance(tile, Barrier) else 0.0 for tile in kinds]


def check_ranges(cfg: CommandTermCfg, *names: str) -> None:
    """Raise RenetError unless each of these fields is a finite range, the lower end first."""
    for name in names:
        low, high = getattr(cfg, name)
        if not -math.inf < low <= high < math.inf:
            raise RenetError(
                f"commands.{name} must be two numbers, the smaller one first, got {low} and {high}"
            )


def check_shares(**shares: float) -> None:
    """Raise RenetError naming a share that is not from 0 to 1."""
    for name, share in shares.items():
        if not 0.0 <= share <= 1.0:
            raise RenetError(f"commands.{name} must be from 0 to 1, got {share}")


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
    told: Told = "heading"
    """How robots are told their goals: by (c_x, sin e, cos e) with e = c_yaw - yaw, or by the twist
    (c_x, 0, TURN_GAIN e), its turn rate at most MAX_TURN."""
    fixed_speed: float | None = None
    """c_x for evaluation, m/s; c_yaw then stays each robot's starting yaw."""

    def __post_init__(self) -> None:
        check_ranges(self, "resampling_time_range", "speed", "later_speed")
        check_shares(standing_share=self.standing_share)

    def build(self, env: ManagerBasedRlEnv) -> "GoalCommand":
        return GoalCommand(self, env)


class GoalCommand(CommandTerm):
    """Holds c_x and c_yaw; `command` is what robots are told of them, [N, 3]."""

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
        self.free = torch.zeros(self.num_envs, dtype=torch.bool, device=self.device)
        """Robots that follow a velocity in their own frame, not a goal, [N] bool."""
        self.clear = torch.tensor(clear_widths(env), device=self.device)
        """Half-width of the ground around the start of each kind of tile with barriers, m."""
        self._command = torch.zeros(self.num_envs, 3, device=self.device)

    @property
    def command(self) -> Tensor:
        """What robots are told, [N, 3], as interface.TOLD says."""
        return self._command

    @property
    def turn(self) -> Tensor:
        """Turn rate towards c_yaw, [N] rad/s; 0 of robots told to stand."""
        turn = (TURN_GAIN * self.heading_error).clamp(-MAX_TURN, MAX_TURN)
        return turn * (self.speed > 0.0)

    @property
    def stands(self) -> Tensor:
        """Robots told neither to walk nor to turn, [N] bool."""
        return self.speed <= 0.0

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
        if self.cfg.told == "heading":
            error = self.yaw - base_heading(self._env)
            told = self.speed, error.sin(), error.cos()
        else:
            told = self.speed, torch.zeros_like(self.speed), self.turn
        self._command = torch.stack(told, dim=-1)

    def _update_metrics(self) -> None: ...


@dataclass(kw_only=True)
class DriveCommandCfg(GoalCommandCfg):
    """How velocities are drawn, beside goals."""

    told: Told = "twist"
    free_shares: dict[str, float] = field(default_factory=dict)
    """Share of redrawn commands that are velocities, by kind of tile; `plane` is ground without
    tiles. Kinds that are not named have goals alone."""
    forward: tuple[float, float] = (-MAX_REVERSE, MAX_SPEED)
    """Range of v_x, m/s."""
    sideways: float = MAX_SIDEWAYS
    """Largest |v_y|, m/s."""
    turn: float = MAX_TURN
    """Largest |omega_z|, rad/s."""
    straight_share: float = 0.3
    """Share of velocities along x or y alone."""
    unturned_share: float = 0.3
    """Share of velocities without a turn."""
    spot_share: float = 0.15
    """Share of velocities of 0 with a turn."""
    kick_share: float = 0.0
    """Share of new velocities at which the robot is given what it is told to reach, at once: it
    then meets what it could not find by chance, and need only keep it up."""
    kick_interval: float = 0.0
    """Mean time between further kicks of a robot that lags behind its velocity, s; 0 for none."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ranges(self, "forward")
        for name in ("sideways", "turn", "kick_interval"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise RenetError(f"commands.{name} must be at least 0, got {getattr(self, name)}")
        check_shares(
            **{f"free_shares[{kind!r}]": share for kind, share in self.free_shares.items()},
            straight_share=self.straight_share,
            unturned_share=self.unturned_share,
            spot_share=self.spot_share,
            kick_share=self.kick_share,
        )

    def build(self, env: ManagerBasedRlEnv) -> "DriveCommand":
        return DriveCommand(self, env)


class DriveCommand(GoalCommand):
    """Goals, and velocities in the robots' own frames."""

    cfg: DriveCommandCfg

    def __init__(self, cfg: DriveCommandCfg, env: ManagerBasedRlEnv) -> None:
        super().__init__(cfg, env)
        self.velocity = torch.zeros(self.num_envs, 2, device=self.device)
        """(v_x, v_y) of robots that follow a velocity, [N, 2] m/s."""
        self.free_turn = torch.zeros(self.num_envs, device=self.device)
        """omega_z of robots that follow a velocity, [N] rad/s; with 0 they keep their heading."""
        self.fixed_twist: Tensor | None = None
        """For evaluation: the twist that each robot follows from its next start on, [N, 3]."""
        self._free_share = torch.zeros(self.num_envs, device=self.device)
        for kind, share in cfg.free_shares.items():
            self._free_share[on_tiles(env, kind)] = share
        terrain = env.scene.terrain
        if terrain is None or terrain.cfg.terrain_generator is None:
            self._free_share[:] = cfg.free_shares.get(PLANE, 0.0)

    @property
    def direction(self) -> Tensor:
        """Unit vector of the commanded velocity in the world frame, [N, 2]."""
        world = rotated(self.velocity, base_heading(self._env))
        world = world / self.speed.clamp_min(1e-5).unsqueeze(-1)
        return torch.where(self.free.unsqueeze(-1), world, super().direction)

    @property
    def turn(self) -> Tensor:
        """Turn rate that robots are told, [N] rad/s: towards their heading, or one of its own."""
        return torch.where(self.free & (self.free_turn != 0.0), self.free_turn, super().turn)

    @property
    def stands(self) -> Tensor:
        """Robots told neither to walk nor to turn, [N] bool."""
        return (self.speed <= 0.0) & (self.turn == 0.0)

    def compute(self, dt: float | Tensor, env_ids: Tensor | None = None) -> None:
        """Let time pass, as `GoalCommand.compute` does."""
        walked = self.commanded_distance.clone()
        super().compute(dt, env_ids)
        # A velocity leads nowhere in particular: it owes no distance.
        self.commanded_distance = torch.where(self.free, walked, self.commanded_distance)
        # With robots to compute, only commands are computed: no time passes.
        if env_ids is None and self.cfg.kick_interval and self.cfg.fixed_speed is None:
            self._kick_stragglers(dt)

    def _resample_command(self, env_ids: Tensor) -> None:
        super()._resample_command(env_ids)
        cfg = self.cfg
        if self.fixed_twist is not None:
            everybody = torch.ones_like(env_ids, dtype=torch.bool)
            twist = self.fixed_twist[env_ids]
            self._follow(env_ids, everybody, twist[:, :2], twist[:, 2])
            return
        if cfg.fixed_speed is not None:
            return

        def uniform(low: float, high: float) -> Tensor:
            return torch.empty(len(env_ids), device=self.device).uniform_(low, high)

        forward = uniform(*cfg.forward)
        left = uniform(-cfg.sideways, cfg.sideways)
        turn = uniform(-cfg.turn, cfg.turn)
        straight = uniform(0.0, 1.0)
        left = left * (straight >= 2 * cfg.straight_share / 3)
        forward = forward * (straight <= 1.0 - cfg.straight_share / 3)
        velocity = torch.stack((forward, left), dim=-1)
        spot = uniform(0.0, 1.0) < cfg.spot_share
        velocity = velocity * (~spot & (velocity.norm(dim=-1) >= cfg.slowest)).unsqueeze(-1)
        turn = turn * (spot | (uniform(0.0, 1.0) >= cfg.unturned_share))
        free = uniform(0.0, 1.0) < self._free_share[env_ids]
        # Goals to stand stay what they are.
        free &= self.speed[env_ids] > 0.0
        self._follow(env_ids, free, velocity, turn)
        if cfg.kick_share:
            self._kick(env_ids, free & (uniform(0.0, 1.0) < cfg.kick_share), velocity, turn)

    def _follow(self, env_ids: Tensor, free: Tensor, velocity: Tensor, turn: Tensor) -> None:
        """Let robots that are `free`, [K] bool, follow a velocity [K, 2] and a turn rate [K]."""
        self.free[env_ids] = free
        self.velocity[env_ids] = velocity
        self.free_turn[env_ids] = turn
        self.speed[env_ids] = torch.where(free, velocity.norm(dim=-1), self.speed[env_ids])
        # Whoever is not told to turn keeps the heading that he has now, as an operator expects.
        heading = self._written_heading(env_ids)
        self.yaw[env_ids] = torch.where(free, heading, self.yaw[env_ids])

    def _kick(self, env_ids: Tensor, kicked: Tensor, velocity: Tensor, turn: Tensor) -> None:
        """Give robots that are `kicked`, [K] bool, a velocity [K, 2] m/s and a turn rate [K]."""
        address = self.robot.indexing.free_joint_v_adr
        written = self._env.sim.data.qvel
        world = rotated(velocity, self._written_heading(env_ids))
        # A free joint turns in its own frame.
        given = {0: world[:, 0], 1: world[:, 1], 5: turn}
        for axis, value in given.items():
            before = written[env_ids, address[axis]]
            written[env_ids, address[axis]] = torch.where(kicked, value, before)

    def _kick_stragglers(self, dt: float | Tensor) -> None:
        """Kick robots that follow less than half of their velocity, at random times."""
        velocity = self.direction * self.speed.unsqueeze(-1)
        error = (base_velocity(self._env)[:, :2] - velocity).norm(dim=-1)
        lags = self.free & (self.speed > 0.0) & (error > MAX_LAG * self.speed)
        now = torch.rand_like(error) < dt / self.cfg.kick_interval
        env_ids = (lags & now).nonzero().flatten()
        everybody = torch.ones_like(env_ids, dtype=torch.bool)
        self._kick(env_ids, everybody, self.velocity[env_ids], self.free_turn[env_ids])

    def _update_command(self, env_ids: Tensor | None) -> None:
        super()._update_command(env_ids)
        told = torch.cat((self.velocity, self.turn.unsqueeze(-1)), dim=-1)
        self._command = torch.where(self.free.unsqueeze(-1), told, self._command)


def goal(env: ManagerBasedRlEnv) -> GoalCommand:
    """The task's command term."""
    return env.command_manager.get_term(COMMAND)  # type: ignore[return-value]
