"""The paper's rewards (RENet, Method A, footnote, and eq. 6); scales are in config.py.

World-frame quantities use the horizontal plane: <v, n_yaw> has no vertical part.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from mjlab.entity import Entity
from torch import Tensor

from renet.tasks.commands import COMMAND, GoalCommand
from renet.tasks.observations import CALF_CONTACT, THIGH_TRUNK_CONTACT

if TYPE_CHECKING:
    from mjlab.envs import ManagerBasedRlEnv

    from renet.tasks.env import RenetEnv

CONTACT_FORCE = 0.1
"""N above which a touch is a collision (Extreme Parkour)."""


def goal(env: ManagerBasedRlEnv) -> GoalCommand:
    """The task's command term."""
    return env.command_manager.get_term(COMMAND)  # type: ignore[return-value]


def unweighted(env: RenetEnv, reward: str) -> Tensor:
    """A reward of this step before its weight, [N], to log."""
    return env.reward_manager.value(reward)


def goal_velocity(velocity: Tensor, direction: Tensor, speed: Tensor) -> Tensor:
    """r_lin_vel (RENet eq. 6).

    Args:
        velocity: [N, 2] m/s, world. direction: [N, 2], n_yaw. speed: [N], c_x in m/s.

    Returns:
        [N]; at most 1: there is no bonus, and no penalty, for overshooting.
    """
    along = (velocity * direction).sum(-1)
    moving = torch.minimum(along, speed) / (speed + 1e-5)
    standing = 1.0 / (1.0 + velocity.norm(dim=-1))
    return torch.where(speed > 0.0, moving, standing)


def linear_velocity(env: ManagerBasedRlEnv) -> Tensor:
    """Goal-guided linear velocity tracking."""
    command = goal(env)
    velocity = env.scene["robot"].data.root_link_lin_vel_w[:, :2]
    return goal_velocity(velocity, command.direction, command.speed)


def yaw(env: ManagerBasedRlEnv) -> Tensor:
    """exp(-|c_yaw - yaw|): angular tracking in Extreme Parkour's form."""
    return torch.exp(-goal(env).heading_error.abs())


def collision_count(thigh_trunk: Tensor, calf: Tensor) -> Tensor:
    """Bodies that touch something they should not, [N].

    Args:
        thigh_trunk: contact forces [N, 5, 3] of four thighs and the trunk, N.
        calf: [N, 4 G, 3], G geoms per calf (the foot is not one of them).
    """
    bodies = (thigh_trunk.norm(dim=-1) > CONTACT_FORCE).sum(-1)
    calves = (calf.norm(dim=-1) > CONTACT_FORCE).unflatten(-1, (4, -1)).any(-1).sum(-1)
    return (bodies + calves).float()


def collision(env: ManagerBasedRlEnv) -> Tensor:
    """Number of thighs, calves and trunk in contact."""
    return collision_count(
        env.scene[THIGH_TRUNK_CONTACT].data.force, env.scene[CALF_CONTACT].data.force
    )


def joint_energy(env: ManagerBasedRlEnv) -> Tensor:
    """Sum of |torque * joint velocity|, W (our reading of "joint energy")."""
    data = env.scene["robot"].data
    return (data.qfrc_actuator * data.joint_vel).abs().sum(-1)


def action_rate(env: ManagerBasedRlEnv) -> Tensor:
    """Euclidean norm of the change of action (Extreme Parkour: not squared)."""
    return (env.action_manager.action - env.action_manager.prev_action).norm(dim=-1)


def default_position(env: ManagerBasedRlEnv) -> Tensor:
    """Squared distance of all joints to the default pose, rad^2."""
    data = env.scene["robot"].data
    return (data.joint_pos - data.default_joint_pos).square().sum(-1)


class HipPosition:
    """Squared distance of the hips to the default pose, rad^2."""

    def __init__(self, cfg, env: ManagerBasedRlEnv) -> None:
        del cfg
        hips, _ = env.scene["robot"].find_joints(".*_hip_joint")
        self._hips = torch.tensor(hips, device=env.device)

    def __call__(self, env: ManagerBasedRlEnv) -> Tensor:
        """[N]."""
        data = env.scene["robot"].data
        offset = data.joint_pos - data.default_joint_pos
        return offset[:, self._hips].square().sum(-1)


class JointAcceleration:
    """Sum of squared joint accelerations from control-step differences, (rad/s^2)^2."""

    def __init__(self, cfg, env: ManagerBasedRlEnv) -> None:
        del cfg
        self._previous = torch.zeros_like(env.scene["robot"].data.joint_vel)

    def __call__(self, env: ManagerBasedRlEnv) -> Tensor:
        """Update and return [N]."""
        velocity = env.scene["robot"].data.joint_vel
        acceleration = (velocity - self._previous) / env.step_dt
        self._previous = velocity
        return acceleration.square().sum(-1)

    def reset(self, env_ids: Tensor | slice | None = None) -> None:
        """A new episode starts at rest."""
        self._previous[slice(None) if env_ids is None else env_ids] = 0.0


def orientation(env: ManagerBasedRlEnv) -> Tensor:
    """Squared horizontal part of gravity in the base frame: sin^2 of the tilt."""
    return env.scene["robot"].data.projected_gravity_b[:, :2].square().sum(-1)


class StandingMotion:
    """Sum of squared, smoothed joint velocities of robots told to stand, (rad/s)^2.

    Not in the paper, whose reward is all but flat at rest: 7 cm/s of creeping cost it 7 %.
    Smoothed, because exploration shakes the joints as fast as steps move them, but to and fro.
    """

    def __init__(self, cfg, env: ManagerBasedRlEnv) -> None:
        del cfg
        self._velocity = torch.zeros_like(env.scene["robot"].data.joint_vel)

    def __call__(self, env: ManagerBasedRlEnv, time_constant: float) -> Tensor:
        """Update and return [N].

        Args:
            time_constant: of the smoothing, s.
        """
        velocity = env.scene["robot"].data.joint_vel
        self._velocity = self._velocity.lerp(velocity, env.step_dt / time_constant)
        return torch.where(goal(env).speed > 0.0, 0.0, self._velocity.square().sum(-1))

    def reset(self, env_ids: Tensor | slice | None = None) -> None:
        """A new episode starts at rest."""
        self._velocity[slice(None) if env_ids is None else env_ids] = 0.0


class FootClearance:
    """Low feet that move: lack of lift squared times horizontal speed, summed over feet, m^3/s.

    Not in the paper (HIMLoco rewards clearance likewise): millions of steps on a CPU, instead of
    billions on a GPU, otherwise end in a shuffle that trips over the first stair. Lift is measured
    against the trunk, so that it means the same on stairs.
    """

    def __init__(self, cfg, env: ManagerBasedRlEnv) -> None:
        robot: Entity = env.scene["robot"]
        sites, _ = robot.find_sites(cfg.params["feet"], preserve_order=True)
        self._sites = robot.indexing.site_ids[sites]
        self._previous = torch.full((env.num_envs, len(sites), 2), torch.nan, device=env.device)

    def __call__(
        self, env: ManagerBasedRlEnv, feet: tuple[str, ...], height: float, lift: float
    ) -> Tensor:
        """Update and return [N].

        Args:
            feet: names of the feet's sites.
            height: of the trunk over feet that stand, m.
            lift: wanted of a foot in swing, m.
        """
        robot = env.scene["robot"].data
        # Not `robot.site_pos_w`, which derives every site's rotation, too.
        feet_position = env.sim.data.site_xpos[:, self._sites]
        ground = robot.root_link_pos_w[:, None, 2] - height
        lack = (lift - (feet_position[..., 2] - ground)).clamp(0.0, lift)
        # NaN where an episode has just begun: no speed is known yet.
        speed = (feet_position[..., :2] - self._previous).norm(dim=-1).nan_to_num() / env.step_dt
        self._previous = feet_position[..., :2].clone()
        return (lack.square() * speed).sum(-1)

    def reset(self, env_ids: Tensor | slice | None = None) -> None:
        """Forget where the feet were."""
        self._previous[slice(None) if env_ids is None else env_ids] = torch.nan
