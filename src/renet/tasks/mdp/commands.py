"""Commands of the robots: goals (RENet, Method C), and velocities in their own frames.

A goal is a random forward speed c_x with a random yaw c_yaw in the world frame. The paper has goals
alone. The recipe's robots also follow velocities in any direction, as an operator steers them.
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
from renet.tasks.mdp.base_state import base_heading, on_tiles, rotated
from renet.terrain.tiles import Barrier

COMMAND = "goal"
"""Name of the command term in every RENet task."""
PLANE = "plane"
"""Ground without tiles."""


def clear_widths(env: ManagerBasedRlEnv) -> list[float]:
    """Return the half-width of the ground around the start of each kind of tile, m.

    It is 0 for kinds without barriers.
    """
    terrain = env.scene.terrain
    if terrain is None or terrain.cfg.terrain_generator is None:
        return []
    kinds = terrain.cfg.terrain_generator.sub_terrains.values()
    return [tile.clear if isinstance(tile, Barrier) else 0.0 for tile in kinds]


def check_ranges(cfg: CommandTermCfg, *names: str) -> None:
    """Raise RenetError unless all fields `names` are finite ranges, smaller number first."""
    for name in names:
        low, high = getattr(cfg, name)
        if not -math.inf < low <= high < math.inf:
            raise RenetError(
                f"commands.{name} must be two numbers, the smaller one first, got {low} and {high}"
            )


def check_shares(**shares: float) -> None:
    """Raise RenetError, with the share's name, for a share that is not from 0 to 1."""
    for name, share in shares.items():
        if not 0.0 <= share <= 1.0:
            raise RenetError(f"commands.{name} must be from 0 to 1, got {share}")


@dataclass(kw_only=True)
class GoalCommandCfg(CommandTermCfg):
    """Distribution of goals."""

    resampling_time_range: tuple[float, float] = (2.0, 8.0)
    """Range of the time between goals, s. Most robots have left their tile after 7 s: if goals
    changed later, robots would learn to stand, but not to stop."""
    speed: tuple[float, float] = (0.2, 1.0)
    """Range of c_x at stage 0 (paper's first level), m/s."""
    later_speed: tuple[float, float] = (0.0, 1.0)
    """Range of c_x at stage 1 (paper's second level), m/s."""
    standing_share: float = 0.3
    """Share of goals with c_x = 0 at stage 1, which a uniform distribution would never draw. An
    episode does not begin with one, because stopping is harder to learn than standing."""
    slowest: float = 0.1
    """Speed below which c_x is set to 0 at stage 1, m/s: eq. 6 divides by c_x, and noise hides
    slower motion."""
    first_turn: float = math.pi / 2
    """Largest |c_yaw - yaw| at the beginning of an episode, rad; uniform."""
    later_turn: float = math.pi / 3
    """Largest change of c_yaw from goal to goal, rad. It is less than a right angle, so that robots
    leave their tiles."""
    told: Told = "heading"
    """Form of the command that robots observe: `heading` is (c_x, sin e, cos e) with
    e = c_yaw - yaw; `twist` is (c_x, 0, TURN_GAIN e), with a turn rate of at most MAX_TURN."""
    fixed_speed: float | None = None
    """Constant c_x for evaluation, m/s; c_yaw is then the yaw with which each robot starts."""

    def __post_init__(self) -> None:
        check_ranges(self, "resampling_time_range", "speed", "later_speed")
        check_shares(standing_share=self.standing_share)

    def build(self, env: ManagerBasedRlEnv) -> "GoalCommand":
        return GoalCommand(self, env)


class GoalCommand(CommandTerm):
    """Goals of all robots; `command` is the form in which robots observe them."""

    cfg: GoalCommandCfg

    def __init__(self, cfg: GoalCommandCfg, env: ManagerBasedRlEnv) -> None:
        super().__init__(cfg, env)
        self.robot: Entity = env.scene["robot"]
        self.stage = 0
        """Stage of the paper's two-level curriculum. 0: all goals are to walk; 1: some are to
        stand."""
        self.standing_time = 1.0
        """Duration of goals to stand, as a multiple of that of others."""
        self.speed = torch.zeros(self.num_envs, device=self.device)
        """c_x, [N] m/s."""
        self.yaw = torch.zeros(self.num_envs, device=self.device)
        """c_yaw, [N] rad, world frame."""
        self.commanded_distance = torch.zeros(self.num_envs, device=self.device)
        """Integral of c_x over the episode so far, [N] m."""
        self.free = torch.zeros(self.num_envs, dtype=torch.bool, device=self.device)
        """True for robots that follow a velocity in their own frame instead of a goal, [N] bool."""
        self.clear = torch.tensor(clear_widths(env), device=self.device)
        """Half-width of the ground around the start by kind of tile, m (see `clear_widths`)."""
        self._command = torch.zeros(self.num_envs, 3, device=self.device)

    @property
    def command(self) -> Tensor:
        """Command as robots observe it, [N, 3] (see `GoalCommandCfg.told`)."""
        return self._command

    @property
    def turn(self) -> Tensor:
        """Turn rate towards c_yaw, [N] rad/s; 0 for robots told to stand."""
        turn = (TURN_GAIN * self.heading_error).clamp(-MAX_TURN, MAX_TURN)
        return turn * (self.speed > 0.0)

    @property
    def stands(self) -> Tensor:
        """True for robots told neither to walk nor to turn, [N] bool."""
        return self.speed <= 0.0

    @property
    def heading_error(self) -> Tensor:
        """c_yaw - yaw, wrapped to [-pi, pi], [N] rad."""
        error = self.yaw - base_heading(self._env)
        return (error + math.pi) % (2.0 * math.pi) - math.pi

    @property
    def direction(self) -> Tensor:
        """Unit vector n_yaw = (cos c_yaw, sin c_yaw) in the world frame, [N, 2] (RENet eq. 6)."""
        return torch.stack((self.yaw.cos(), self.yaw.sin()), dim=-1)

    def reset(self, env_ids: Tensor | slice | None) -> dict[str, float]:
        """Begin episodes with new goals."""
        self.commanded_distance[env_ids] = 0.0
        return super().reset(env_ids)

    def compute(self, dt: float | Tensor, env_ids: Tensor | None = None) -> None:
        """Advance time, and draw new goals for robots whose time is up.

        Args:
            dt: Time since the last call, s; a tensor [N] is zero for robots that begin an episode.
            env_ids: Robots to compute, by default all; time passes only for all.
        """
        if env_ids is None:
            self.commanded_distance += self.speed * dt
        super().compute(dt, env_ids)

    def _resample_command(self, env_ids: Tensor) -> None:
        def uniform(low: float, high: float) -> Tensor:
            return torch.empty(len(env_ids), device=self.device).uniform_(low, high)

        cfg = self.cfg
        begins = self.command_counter[env_ids] == 0
        turn = torch.where(begins, cfg.first_turn, cfg.later_turn) * uniform(-1.0, 1.0)
        if cfg.fixed_speed is not None:
            speed = torch.full_like(turn, cfg.fixed_speed)
            turn = torch.zeros_like(turn)
        elif self.stage == 0:
            speed = uniform(*cfg.speed)
        else:
            speed = uniform(*cfg.later_speed)
            stands = (uniform(0.0, 1.0) < cfg.standing_share) & ~begins
            stands |= speed < cfg.slowest
            speed *= ~stands
            self.time_left[env_ids] *= torch.where(stands, self.standing_time, 1.0)
        self.speed[env_ids] = speed
        # The first goal turns from the robot's heading, later ones from the goal before.
        old_yaw = torch.where(begins, self._written_heading(env_ids), self.yaw[env_ids])
        self.yaw[env_ids] = wrap_to_pi(old_yaw + turn)

    def _written_heading(self, env_ids: Tensor) -> Tensor:
        """Compute the yaw of the pose in `qpos`, which a reset may have just written, [E] rad."""
        address = self.robot.indexing.free_joint_q_adr[3:7]
        w, x, y, z = self._env.sim.data.qpos[env_ids[:, None], address].unbind(-1)
        return torch.atan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z))

    def _update_command(self, env_ids: Tensor | None) -> None:
        if self.cfg.told == "heading":
            error = self.yaw - base_heading(self._env)
            told = (self.speed, error.sin(), error.cos())
        else:
            told = (self.speed, torch.zeros_like(self.speed), self.turn)
        self._command = torch.stack(told, dim=-1)

    def _update_metrics(self) -> None: ...


@dataclass(kw_only=True)
class DriveCommandCfg(GoalCommandCfg):
    """Distribution of velocities and goals."""

    told: Told = "twist"
    free_shares: dict[str, float] = field(default_factory=dict)
    """Share of commands that are velocities, by kind of tile; `plane` is ground without tiles. On
    other kinds all commands are goals."""
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

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ranges(self, "forward")
        for name in ("sideways", "turn"):
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
        """Velocity (v_x, v_y) of robots that follow one, base frame, [N, 2] m/s."""
        self.free_turn = torch.zeros(self.num_envs, device=self.device)
        """Turn rate omega_z of these robots, [N] rad/s; at 0 they keep their heading."""
        self.kick_share = cfg.kick_share
        """Share of new velocities that robots are given at once (see `DriveCommandCfg`)."""
        self.fixed_twist: Tensor | None = None
        """Twist that each robot follows in evaluation from its next episode on, [N, 3], or None."""

    @property
    def _free_share(self) -> Tensor:
        """Share of commands that are velocities, of each robot on its tile, [N]."""
        terrain = self._env.scene.terrain
        if terrain is None or terrain.cfg.terrain_generator is None:
            plane = self.cfg.free_shares.get(PLANE, 0.0)
            return torch.full((self.num_envs,), plane, device=self.device)
        share = torch.zeros(self.num_envs, device=self.device)
        for kind, value in self.cfg.free_shares.items():
            share = share.masked_fill(on_tiles(self._env, kind), value)
        return share

    @property
    def direction(self) -> Tensor:
        """Unit vector of the commanded velocity in the world frame, [N, 2]."""
        world = rotated(self.velocity, base_heading(self._env))
        world = world / self.speed.clamp_min(1e-5).unsqueeze(-1)
        return torch.where(self.free.unsqueeze(-1), world, super().direction)

    @property
    def turn(self) -> Tensor:
        """Turn rate that robots are told, [N] rad/s: omega_z, or where it is 0, towards c_yaw."""
        return torch.where(self.free & (self.free_turn != 0.0), self.free_turn, super().turn)

    @property
    def stands(self) -> Tensor:
        """True for robots told neither to walk nor to turn, [N] bool."""
        return (self.speed <= 0.0) & (self.turn == 0.0)

    def compute(self, dt: float | Tensor, env_ids: Tensor | None = None) -> None:
        """Advance time (see `GoalCommand.compute`)."""
        walked = self.commanded_distance.clone()
        super().compute(dt, env_ids)
        # A velocity leads nowhere in particular: it owes no distance.
        self.commanded_distance = torch.where(self.free, walked, self.commanded_distance)

    def _resample_command(self, env_ids: Tensor) -> None:
        super()._resample_command(env_ids)
        cfg = self.cfg
        # In evaluation all robots follow the same kind of command, which is not random.
        if self.fixed_twist is not None:
            everybody = torch.ones_like(env_ids, dtype=torch.bool)
            twist = self.fixed_twist[env_ids]
            self._follow(env_ids, everybody, twist[:, :2], twist[:, 2])
            return
        if cfg.fixed_speed is not None:
            return

        def uniform(low: float, high: float) -> Tensor:
            return torch.empty(len(env_ids), device=self.device).uniform_(low, high)

        # Velocities in all directions, some of them along x or y alone.
        forward = uniform(*cfg.forward)
        left = uniform(-cfg.sideways, cfg.sideways)
        turn = uniform(-cfg.turn, cfg.turn)
        straight = uniform(0.0, 1.0)
        left = left * (straight >= 2 * cfg.straight_share / 3)
        forward = forward * (straight <= 1.0 - cfg.straight_share / 3)
        velocity = torch.stack((forward, left), dim=-1)

        # Some robots turn on the spot, and some of the others do not turn.
        spot = uniform(0.0, 1.0) < cfg.spot_share
        velocity = velocity * (~spot & (velocity.norm(dim=-1) >= cfg.slowest)).unsqueeze(-1)
        turn = turn * (spot | (uniform(0.0, 1.0) >= cfg.unturned_share))

        # A share of the goals is replaced, but none to stand.
        free = uniform(0.0, 1.0) < self._free_share[env_ids]
        free &= self.speed[env_ids] > 0.0
        self._follow(env_ids, free, velocity, turn)
        if self.kick_share:
            self._kick(env_ids, free & (uniform(0.0, 1.0) < self.kick_share), velocity, turn)

    def _follow(self, env_ids: Tensor, free: Tensor, velocity: Tensor, turn: Tensor) -> None:
        """Let robots follow a velocity.

        Args:
            env_ids: Robots with a new command, [E].
            free: True for those that follow a velocity, [E] bool.
            velocity: Velocities (v_x, v_y) in the base frame, [E, 2] m/s.
            turn: Turn rates, [E] rad/s.
        """
        self.free[env_ids] = free
        self.velocity[env_ids] = velocity
        self.free_turn[env_ids] = turn
        self.speed[env_ids] = torch.where(free, velocity.norm(dim=-1), self.speed[env_ids])
        # A robot that is not told to turn keeps its present heading, as an operator expects.
        heading = self._written_heading(env_ids)
        self.yaw[env_ids] = torch.where(free, heading, self.yaw[env_ids])

    def _kick(self, env_ids: Tensor, kicked: Tensor, velocity: Tensor, turn: Tensor) -> None:
        """Set the velocity and turn rate of some robots at once.

        Args:
            env_ids: Robots with a new command, [E].
            kicked: True for those to set, [E] bool.
            velocity: Velocities (v_x, v_y) in the base frame, [E, 2] m/s.
            turn: Turn rates, [E] rad/s.
        """
        address = self.robot.indexing.free_joint_v_adr
        written = self._env.sim.data.qvel
        world = rotated(velocity, self._written_heading(env_ids))
        # Of a free joint, linear velocities are in the world frame, angular ones in the base frame.
        given = {0: world[:, 0], 1: world[:, 1], 5: turn}
        for axis, value in given.items():
            before = written[env_ids, address[axis]]
            written[env_ids, address[axis]] = torch.where(kicked, value, before)

    def _update_command(self, env_ids: Tensor | None) -> None:
        super()._update_command(env_ids)
        told = torch.cat((self.velocity, self.turn.unsqueeze(-1)), dim=-1)
        self._command = torch.where(self.free.unsqueeze(-1), told, self._command)


def goal(env: ManagerBasedRlEnv) -> GoalCommand:
    """Return the task's command term."""
    return env.command_manager.get_term(COMMAND)  # type: ignore[return-value]
