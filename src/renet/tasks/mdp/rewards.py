"""The paper's rewards (RENet, Method A, footnote, and eq. 6), and the recipe's.

Weights are in parkour_env_cfg.py and in training/recipe.py. World-frame quantities use the
horizontal plane: <v, n_yaw> has no vertical part. Classes with `reset` remember the step before,
which is to be evaluated once, and forget it when an episode begins.
"""

from typing import Any

import torch
from mjlab.envs import ManagerBasedRlEnv
from mjlab.managers.reward_manager import RewardTermCfg
from torch import Tensor

from renet.interface import LEGS
from renet.tasks.mdp.barriers import before_barrier
from renet.tasks.mdp.base_state import base_position, base_rotation, base_velocity
from renet.tasks.mdp.commands import goal
from renet.tasks.sensors import CALF_CONTACT, FEET_CONTACT, THIGH_TRUNK_CONTACT

LEAST_SPEED = 0.2
"""Commanded speed below which errors of the velocity are divided by this one, m/s."""
SPOT_DRIFT = 0.3
"""Speed at which a robot told to turn on the spot earns nothing, m/s."""
TURN_SLACK = 0.3
"""Error of the turn rate at which a robot told not to turn earns nothing, rad/s."""


def linear_velocity(env: ManagerBasedRlEnv) -> Tensor:
    """Goal-guided linear velocity tracking, r_lin_vel (RENet eq. 6), [N].

    At most 1: there is no bonus, and no penalty, for overshooting.
    """
    command, velocity = goal(env), base_velocity(env)[:, :2]
    towards = (velocity * command.direction).sum(-1)
    walking = torch.minimum(towards, command.speed) / (command.speed + 1e-5)
    standing = 1.0 / (1.0 + velocity.norm(dim=-1))
    return torch.where(command.speed > 0.0, walking, standing)


def velocity_tracking(env: ManagerBasedRlEnv) -> Tensor:
    """Eq. 6 where a goal steers; where a robot follows a velocity c, 1 - |v - c| / |c|, [N].

    At least -1: it grows with every bit of motion in the right direction, also of a robot that
    stands or goes the wrong way. On the spot it is 1 - |v| / SPOT_DRIFT, where that is positive
    times the share of the turn. Before a wall or an edge it is that of a robot told to stand.
    """
    command = goal(env)
    wanted = command.direction * command.speed.unsqueeze(-1)
    error = (base_velocity(env)[:, :2] - wanted).norm(dim=-1)
    moving = 1.0 - error / command.speed.clamp_min(LEAST_SPEED)
    near = 1.0 - error / SPOT_DRIFT
    spot = torch.where(near > 0.0, near * turn_tracking(env), near)
    following = torch.where(command.speed > 0.0, moving, spot).clamp_min(-1.0)
    tracking = torch.where(command.free, following, linear_velocity(env))
    stopping = 1.0 / (1.0 + base_velocity(env)[:, :2].norm(dim=-1))
    return torch.where(before_barrier(env), stopping, tracking)


def turn_tracking(env: ManagerBasedRlEnv) -> Tensor:
    """1 - |omega - c| / max(|c|, TURN_SLACK), at least 0, of turn rates omega and c, [N].

    A robot that stands where it is told to turn by at least TURN_SLACK earns nothing.
    """
    wanted = goal(env).turn
    rate = env.sim.data.qvel[:, env.scene["robot"].indexing.free_joint_v_adr[5]]
    return (1.0 - (rate - wanted).abs() / wanted.abs().clamp_min(TURN_SLACK)).clamp_min(0.0)


def yaw(env: ManagerBasedRlEnv) -> Tensor:
    """exp(-|c_yaw - yaw|), [N]: angular tracking in Extreme Parkour's form."""
    return (-goal(env).heading_error.abs()).exp()


def collision(env: ManagerBasedRlEnv, force: float = 0.1) -> Tensor:
    """Number of thighs, calves and trunk in contact, whatever the number of geoms, [N].

    Args:
        env: environment with the contact sensors of `tasks.sensors`.
        force: contact force above which a touch counts, N (Extreme Parkour).
    """
    bodies = env.scene[THIGH_TRUNK_CONTACT].data.force.norm(dim=-1) > force
    geoms = env.scene[CALF_CONTACT].data.force.norm(dim=-1) > force
    calves = geoms.unflatten(-1, (len(LEGS), -1)).any(-1)
    return (bodies.sum(-1) + calves.sum(-1)).float()


def joint_energy(env: ManagerBasedRlEnv) -> Tensor:
    """Sum of |torque * joint velocity|, [N] W (our reading of "joint energy")."""
    data = env.scene["robot"].data
    return (data.qfrc_actuator * data.joint_vel).abs().sum(-1)


def action_rate(env: ManagerBasedRlEnv) -> Tensor:
    """Euclidean norm of the change of action, [N] (Extreme Parkour: not squared)."""
    return (env.action_manager.action - env.action_manager.prev_action).norm(dim=-1)


class joint_deviation:
    """Squared distance of some joints to the default pose, [N] rad^2.

    Parameters: `joint_names`, patterns of the joints.
    """

    def __init__(self, cfg: RewardTermCfg, env: ManagerBasedRlEnv) -> None:
        joints, _ = env.scene["robot"].find_joints(cfg.params["joint_names"])
        self._joints = torch.tensor(joints, device=env.device)

    def __call__(self, env: ManagerBasedRlEnv, joint_names: tuple[str, ...]) -> Tensor:
        data = env.scene["robot"].data
        return (data.joint_pos - data.default_joint_pos)[:, self._joints].square().sum(-1)


class joint_acceleration:
    """Sum of squared joint accelerations from control-step differences, [N] (rad/s^2)^2.

    An episode starts at rest.
    """

    def __init__(self, cfg: RewardTermCfg, env: ManagerBasedRlEnv) -> None:
        self._before = torch.zeros_like(env.scene["robot"].data.joint_vel)

    def __call__(self, env: ManagerBasedRlEnv) -> Tensor:
        now = env.scene["robot"].data.joint_vel
        change, self._before = now - self._before, now
        return (change / env.step_dt).square().sum(-1)

    def reset(self, env_ids: Tensor | slice | None = None) -> None:
        self._before[env_ids] = 0.0


def orientation(env: ManagerBasedRlEnv) -> Tensor:
    """Squared horizontal part of gravity in the base frame: sin^2 of the tilt, [N]."""
    return base_rotation(env)[:, 2, :2].square().sum(-1)


SMOOTHING = 0.2
"""Time constant of smoothed joint velocities, s."""


class stepping:
    """Feet in the air, at most two at once, as a share of two, of robots told to move, [N].

    Not in the paper. A robot that stands never happens to walk backward or sideways, and one that
    marches on the spot does at every step. A foot counts for no longer than a swing takes.

    Parameters: `swing`, the longest that a foot counts for, s.
    """

    def __init__(self, cfg: RewardTermCfg, env: ManagerBasedRlEnv) -> None:
        self._air = torch.zeros(env.num_envs, len(LEGS), device=env.device)
        """Seconds since each foot last touched, [N, 4]."""

    def __call__(self, env: ManagerBasedRlEnv, swing: float = 0.35) -> Tensor:
        touches = env.scene[FEET_CONTACT].data.found > 0
        self._air = (self._air + env.step_dt) * ~touches
        swings = (self._air > 0.0) & (self._air <= swing)
        return swings.sum(-1).clamp_max(2) / 2 * ~(goal(env).stands | before_barrier(env))

    def reset(self, env_ids: Tensor | slice | None = None) -> None:
        self._air[env_ids] = 0.0


class VelocityFilter:
    """A term that smooths joint velocities since the episode began exponentially."""

    def __init__(self, cfg: Any, env: ManagerBasedRlEnv) -> None:
        self._smoothed = torch.zeros_like(env.scene["robot"].data.joint_vel)

    def smoothed(self, env: ManagerBasedRlEnv) -> Tensor:
        """Take in the velocities of a control step; smoothed ones, [N, J] rad/s."""
        return self._smoothed.lerp_(env.scene["robot"].data.joint_vel, env.step_dt / SMOOTHING)

    def reset(self, env_ids: Tensor | slice | None = None) -> None:
        self._smoothed[env_ids] = 0.0


class standing_motion(VelocityFilter):
    """Sum of squared, smoothed joint velocities of robots told to stand, [N] (rad/s)^2.

    Not in the paper, whose reward is all but flat at rest: 7 cm/s of creeping cost it 7 %.
    Smoothed, because exploration shakes the joints as fast as steps move them, but to and fro.
    """

    def __call__(self, env: ManagerBasedRlEnv) -> Tensor:
        still = goal(env).stands | before_barrier(env)
        return self.smoothed(env).square().sum(-1) * still


class upright_tracking:
    """Velocity tracking as far as the trunk is carried at standing height, 0 to 1, [N].

    Not in the paper: millions of steps on a CPU, instead of billions on a GPU, otherwise end in a
    gait that kneels, at a speed of its own. A bonus, for a sum of penalties is clipped at 0 and
    teaches nothing there. Tracking is r_lin_vel less the share of c_x by which c_x is exceeded; a
    part of that is free, for who runs meets more obstacles in a step and learns sooner.

    Parameters: `standing_height` of the base over feet that stand, m, measured over the lowest, so
    that climbing costs none; `crouch`, the share of it up to which nothing is earned, from where it
    grows linearly; `tolerance`, the share of c_x by which it may be exceeded.
    """

    def __init__(self, cfg: RewardTermCfg, env: ManagerBasedRlEnv) -> None:
        robot = env.scene["robot"]
        self._feet = robot.indexing.site_ids[robot.find_sites(LEGS)[0]]

    def __call__(
        self,
        env: ManagerBasedRlEnv,
        standing_height: float,
        crouch: float = 0.6,
        tolerance: float = 0.4,
    ) -> Tensor:
        lowest = env.sim.data.site_xpos[:, self._feet, 2].amin(-1)
        height = (base_position(env)[:, 2] - lowest) / standing_height
        carried = ((height - crouch) / (1.0 - crouch)).clamp(0.0, 1.0)
        command = goal(env)
        towards = (base_velocity(env)[:, :2] * command.direction).sum(-1)
        share = towards / (command.speed + 1e-5)
        judged = (command.speed > 0.0) & ~command.free & ~before_barrier(env)
        excess = torch.relu(share - 1.0 - tolerance) * judged
        return carried * (velocity_tracking(env) - excess).clamp_min(0.0)


class foot_clearance:
    """Low feet that move: lack of lift squared times horizontal speed, summed over feet, [N] m^3/s.

    Not in the paper (HIMLoco rewards clearance likewise): millions of steps on a CPU, instead of
    billions on a GPU, otherwise end in a shuffle that trips over the first stair. Lift is measured
    against the trunk, so that it means the same on stairs.

    Parameters: `standing_height` of the base over feet that stand, m; `lift` wanted of a foot in
    swing, m.
    """

    def __init__(self, cfg: RewardTermCfg, env: ManagerBasedRlEnv) -> None:
        robot = env.scene["robot"]
        feet, _ = robot.find_sites(LEGS, preserve_order=True)
        self._feet = robot.indexing.site_ids[feet]
        self._before = torch.full((env.num_envs, len(LEGS), 2), torch.nan, device=env.device)

    def __call__(
        self, env: ManagerBasedRlEnv, standing_height: float, lift: float = 0.12
    ) -> Tensor:
        feet = env.sim.data.site_xpos[:, self._feet]
        ground = base_position(env)[:, 2:] - standing_height
        lack = (lift + ground - feet[..., 2]).clamp(0.0, lift)
        moved = (feet[..., :2] - self._before).norm(dim=-1).nan_to_num()
        self._before = feet[..., :2].clone()
        return (lack.square() * moved).sum(-1) / env.step_dt

    def reset(self, env_ids: Tensor | slice | None = None) -> None:
        self._before[env_ids] = torch.nan
