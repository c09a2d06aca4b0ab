"""Rewards of the paper (RENet, Method A, footnote, and eq. 6) and of the recipe.

Weights are in parkour_env_cfg.py and in training/recipe.py. The robot's pose and velocity come from
base_state.py, its command from `commands.goal`, and whether it must stand from
`barriers.must_stand`. Velocities and directions in the world frame are horizontal: <v, n_yaw> has
no vertical part. Classes with `reset` keep a value from one control step to the next, so that they
are called once in each step.
"""

from typing import Any

import torch
from mjlab.envs import ManagerBasedRlEnv
from mjlab.managers.reward_manager import RewardTermCfg
from torch import Tensor

from renet.interface import LEGS
from renet.tasks.mdp.barriers import before_barrier, must_stand
from renet.tasks.mdp.base_state import base_position, base_rotation, base_velocity
from renet.tasks.mdp.commands import goal
from renet.tasks.sensors import CALF_CONTACT, FEET_CONTACT, THIGH_TRUNK_CONTACT

SMOOTHING_TIME = 0.2
"""Time constant of smoothed joint velocities, s."""
LEAST_SPEED = 0.2
"""Smallest speed by which errors of the velocity are divided, m/s."""
SPOT_DRIFT = 0.3
"""Speed at which a robot told to turn on the spot earns nothing, m/s."""
TURN_SLACK = 0.3
"""Error of the turn rate at which a robot told not to turn earns nothing, rad/s."""


def linear_velocity(env: ManagerBasedRlEnv) -> Tensor:
    """Goal-guided linear velocity tracking, r_lin_vel (RENet eq. 6), [N].

    It is at most 1: walking faster than commanded brings neither a bonus nor a penalty.
    """
    command = goal(env)
    velocity = base_velocity(env)[:, :2]
    # Speed along the commanded direction.
    forward = (velocity * command.direction).sum(-1)
    walking = torch.minimum(forward, command.speed) / (command.speed + 1e-5)
    standing = 1.0 / (1.0 + velocity.norm(dim=-1))
    return torch.where(command.speed > 0.0, walking, standing)


def velocity_tracking(env: ManagerBasedRlEnv) -> Tensor:
    """Tracking of goals by eq. 6, and of a velocity c by 1 - |v - c| / |c|, [N].

    The latter is at least -1, so that it grows with any motion in the right direction, also of a
    robot that stands or walks the wrong way. For a robot told to turn on the spot it is
    1 - |v| / SPOT_DRIFT, multiplied by `turn_tracking` where it is positive. A robot in front of a
    wall or an edge has the reward of one told to stand.
    """
    command = goal(env)
    velocity = base_velocity(env)[:, :2]

    # Robots that follow a velocity.
    target = command.direction * command.speed.unsqueeze(-1)
    error = (velocity - target).norm(dim=-1)
    walking = 1.0 - error / command.speed.clamp_min(LEAST_SPEED)
    on_spot = 1.0 - error / SPOT_DRIFT
    turning = torch.where(on_spot > 0.0, on_spot * turn_tracking(env), on_spot)
    following = torch.where(command.speed > 0.0, walking, turning).clamp_min(-1.0)

    # Robots with a goal, and robots that a barrier stops.
    tracking = torch.where(command.free, following, linear_velocity(env))
    stopping = 1.0 / (1.0 + velocity.norm(dim=-1))
    return torch.where(before_barrier(env), stopping, tracking)


def turn_tracking(env: ManagerBasedRlEnv) -> Tensor:
    """Tracking of turn rates: 1 - |omega - c| / max(|c|, TURN_SLACK), at least 0, [N].

    A robot that is told to turn by at least TURN_SLACK, and does not turn, earns nothing.
    """
    target = goal(env).turn
    rate = env.sim.data.qvel[:, env.scene["robot"].indexing.free_joint_v_adr[5]]
    error = (rate - target).abs()
    return (1.0 - error / target.abs().clamp_min(TURN_SLACK)).clamp_min(0.0)


def yaw(env: ManagerBasedRlEnv) -> Tensor:
    """Tracking of the heading, exp(-|c_yaw - yaw|), [N], in Extreme Parkour's form."""
    return (-goal(env).heading_error.abs()).exp()


def collision(env: ManagerBasedRlEnv, force: float = 0.1) -> Tensor:
    """Number of bodies in contact, of thighs, calves and trunk, [N].

    Args:
        env: Environment with the contact sensors of `tasks.sensors`.
        force: Smallest force of a contact that counts, N (Extreme Parkour).
    """
    # A calf counts once, although it has several geoms.
    bodies = env.scene[THIGH_TRUNK_CONTACT].data.force.norm(dim=-1) > force
    geoms = env.scene[CALF_CONTACT].data.force.norm(dim=-1) > force
    calves = geoms.unflatten(-1, (len(LEGS), -1)).any(-1)
    return (bodies.sum(-1) + calves.sum(-1)).float()


def joint_energy(env: ManagerBasedRlEnv) -> Tensor:
    """Sum of |torque * joint velocity|, [N] W (our reading of "joint energy")."""
    data = env.scene["robot"].data
    return (data.qfrc_actuator * data.joint_vel).abs().sum(-1)


def action_rate(env: ManagerBasedRlEnv) -> Tensor:
    """Euclidean norm of the change of action, [N]; not squared, as in Extreme Parkour."""
    return (env.action_manager.action - env.action_manager.prev_action).norm(dim=-1)


class joint_deviation:
    """Squared distance of some joints from the default pose, [N] rad^2.

    Parameters:
        joint_names: Patterns of the joints' names.
    """

    def __init__(self, cfg: RewardTermCfg, env: ManagerBasedRlEnv) -> None:
        joints, _ = env.scene["robot"].find_joints(cfg.params["joint_names"])
        self._joints = torch.tensor(joints, device=env.device)

    def __call__(self, env: ManagerBasedRlEnv, joint_names: tuple[str, ...]) -> Tensor:
        data = env.scene["robot"].data
        return (data.joint_pos - data.default_joint_pos)[:, self._joints].square().sum(-1)


class joint_acceleration:
    """Sum of squared joint accelerations, [N] (rad/s^2)^2.

    An acceleration is the change of velocity over a control step. Episodes start at rest.
    """

    def __init__(self, cfg: RewardTermCfg, env: ManagerBasedRlEnv) -> None:
        # Joint velocities of the last step, [N, J] rad/s.
        self._last = torch.zeros_like(env.scene["robot"].data.joint_vel)

    def __call__(self, env: ManagerBasedRlEnv) -> Tensor:
        velocity = env.scene["robot"].data.joint_vel
        change = velocity - self._last
        self._last = velocity
        return (change / env.step_dt).square().sum(-1)

    def reset(self, env_ids: Tensor | slice | None = None) -> None:
        self._last[env_ids] = 0.0


def orientation(env: ManagerBasedRlEnv) -> Tensor:
    """Squared horizontal part of gravity in the base frame: sin^2 of the tilt, [N]."""
    return base_rotation(env)[:, 2, :2].square().sum(-1)


class stepping:
    """Number of swinging feet divided by two, at most 1, of robots told to move, [N].

    Not in the paper. A robot that stands still never walks backward or sideways by chance, but one
    that marches on the spot does so with every step.

    Parameters:
        swing: Longest time in the air for which a foot counts, s.
    """

    def __init__(self, cfg: RewardTermCfg, env: ManagerBasedRlEnv) -> None:
        # Time since each foot last touched the ground, [N, 4] s.
        self._air = torch.zeros(env.num_envs, len(LEGS), device=env.device)

    def __call__(self, env: ManagerBasedRlEnv, swing: float = 0.35) -> Tensor:
        touches = env.scene[FEET_CONTACT].data.found > 0
        self._air = (self._air + env.step_dt) * ~touches
        swings = (self._air > 0.0) & (self._air <= swing)
        return swings.sum(-1).clamp_max(2) / 2 * ~must_stand(env)

    def reset(self, env_ids: Tensor | slice | None = None) -> None:
        self._air[env_ids] = 0.0


class VelocityFilter:
    """Base of terms that read an exponential moving average of joint velocities."""

    def __init__(self, cfg: Any, env: ManagerBasedRlEnv) -> None:
        self._smoothed = torch.zeros_like(env.scene["robot"].data.joint_vel)

    def smoothed(self, env: ManagerBasedRlEnv) -> Tensor:
        """Advance the average by a control step and return it, [N, J] rad/s."""
        velocity = env.scene["robot"].data.joint_vel
        return self._smoothed.lerp_(velocity, env.step_dt / SMOOTHING_TIME)

    def reset(self, env_ids: Tensor | slice | None = None) -> None:
        self._smoothed[env_ids] = 0.0


class standing_motion(VelocityFilter):
    """Sum of squared, smoothed joint velocities of robots told to stand, [N] (rad/s)^2.

    Not in the paper, whose reward hardly changes near rest: creeping at 7 cm/s costs 7 % of it.
    Velocities are smoothed, because the noise of exploration moves joints as fast as steps do, but
    back and forth.
    """

    def __call__(self, env: ManagerBasedRlEnv) -> Tensor:
        return self.smoothed(env).square().sum(-1) * must_stand(env)


class upright_tracking:
    """Velocity tracking multiplied by how upright the robot walks, from 0 to 1, [N].

    Not in the paper: with millions of environment steps instead of billions, robots otherwise learn
    to walk on their knees, at a speed of their own. This is a bonus and not a penalty, because a
    sum of rewards below zero is clipped and teaches nothing. A robot with a goal loses the share of
    c_x by which it exceeds c_x, beyond a tolerance. The tolerance is large, because faster robots
    meet more obstacles and learn sooner.

    Parameters:
        standing_height: Height of the base above feet that stand, m. A robot's height is measured
            above its lowest foot, so that climbing costs nothing.
        crouch: Share of that height up to which a robot earns nothing; from there the factor grows
            linearly.
        tolerance: Share of c_x by which a robot may exceed c_x.
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
        # Factor of the height: 0 for a robot that crouches, 1 for one that stands.
        lowest_foot = env.sim.data.site_xpos[:, self._feet, 2].amin(-1)
        height = (base_position(env)[:, 2] - lowest_foot) / standing_height
        upright = ((height - crouch) / (1.0 - crouch)).clamp(0.0, 1.0)

        # Speed beyond the goal's; the tracking of velocities measures it already.
        command = goal(env)
        forward = (base_velocity(env)[:, :2] * command.direction).sum(-1)
        share = forward / (command.speed + 1e-5)
        has_limit = (command.speed > 0.0) & ~command.free & ~before_barrier(env)
        excess = torch.relu(share - 1.0 - tolerance) * has_limit
        return upright * (velocity_tracking(env) - excess).clamp_min(0.0)


class foot_clearance:
    """Squared lack of lift times horizontal speed, summed over the feet, [N] m^3/s.

    Not in the paper (HIMLoco has a similar reward): with millions of environment steps instead of
    billions, robots otherwise learn to shuffle, and trip over the first stair. Lift is measured
    from the trunk, so that it means the same on stairs.

    Parameters:
        standing_height: Height of the base above feet that stand, m.
        lift: Lift from which a moving foot costs nothing, m.
    """

    def __init__(self, cfg: RewardTermCfg, env: ManagerBasedRlEnv) -> None:
        robot = env.scene["robot"]
        feet, _ = robot.find_sites(LEGS, preserve_order=True)
        self._feet = robot.indexing.site_ids[feet]
        # Horizontal positions of the feet in the last step, [N, 4, 2] m; NaN before the first.
        self._last = torch.full((env.num_envs, len(LEGS), 2), torch.nan, device=env.device)

    def __call__(
        self, env: ManagerBasedRlEnv, standing_height: float, lift: float = 0.12
    ) -> Tensor:
        feet = env.sim.data.site_xpos[:, self._feet]
        ground = base_position(env)[:, 2:] - standing_height
        lack = (lift + ground - feet[..., 2]).clamp(0.0, lift)
        distance = (feet[..., :2] - self._last).norm(dim=-1).nan_to_num()
        self._last = feet[..., :2].clone()
        return (lack.square() * distance).sum(-1) / env.step_dt

    def reset(self, env_ids: Tensor | slice | None = None) -> None:
        self._last[env_ids] = torch.nan
