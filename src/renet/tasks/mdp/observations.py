"""Observations that mjlab lacks: true quantities for critics and estimators, and depth."""

from typing import cast

import torch
from mjlab.envs import ManagerBasedRlEnv
from mjlab.managers.observation_manager import ObservationTermCfg
from mjlab.managers.scene_entity_config import SceneEntityCfg
from torch import Tensor

from renet.sim.depth.camera import DepthCamera
from renet.tasks.mdp.base_state import base_rotation, base_velocity, on_tiles
from renet.tasks.mdp.commands import goal
from renet.tasks.mdp.rewards import VelocityFilter
from renet.tasks.sensors import DEPTH_CAMERA, FEET_CONTACT
from renet.terrain.tiles import BARRIERS, DIFFICULT


def proprioception(env: ManagerBasedRlEnv, joints: SceneEntityCfg) -> Tensor:
    """Readings of the robot's own sensors before scaling, [N, 45].

    Terms, order and units are those of interface.PROPRIOCEPTION.

    Args:
        env: The environment.
        joints: The robot's joints in the order of interface.JOINTS.
    """
    robot = env.scene["robot"]
    order = joints.joint_ids
    terms = (
        env.sim.data.qvel[:, robot.indexing.free_joint_v_adr[3:]],
        -base_rotation(env)[:, 2],
        goal(env).command,
        (robot.data.joint_pos_biased - robot.data.default_joint_pos)[:, order],
        robot.data.joint_vel[:, order],
        env.action_manager.action,
    )
    return torch.cat(terms, dim=-1)


def velocity(env: ManagerBasedRlEnv) -> Tensor:
    """True linear velocity of the base in the base frame, [N, 3] m/s."""
    return (base_velocity(env).unsqueeze(1) @ base_rotation(env)).squeeze(1)


def sensor(env: ManagerBasedRlEnv, name: str) -> Tensor:
    """Heights that a terrain sensor measures: a map [N, 132], or those of the feet [N, 4], m."""
    return env.scene[name].data


def depth(env: ManagerBasedRlEnv) -> Tensor:
    """Newest depth image, [N, 48, 64] float16 in [0, 1]; it changes at 10 Hz ticks only."""
    return cast(DepthCamera, env.scene[DEPTH_CAMERA]).normalised()


def feet_contact(env: ManagerBasedRlEnv) -> Tensor:
    """1 where a foot touches the terrain, [N, 4]."""
    return (env.scene[FEET_CONTACT].data.found > 0).float()


def difficult(env: ManagerBasedRlEnv) -> Tensor:
    """1 on a kind of tile that needs vision, [N, 1]."""
    return on_tiles(env, *DIFFICULT, *BARRIERS).float().unsqueeze(-1)


def stalled_seconds(env: ManagerBasedRlEnv) -> Tensor:
    """Time since the robot last made progress, after which `stalled` ends the episode, [N, 1] s.

    It is zero in tasks without that termination.
    """
    # mjlab computes observations once before it creates this manager.
    manager = getattr(env, "termination_manager", None)
    if manager is None or "stalled" not in manager.active_terms:
        return torch.zeros(env.num_envs, 1, device=env.device)
    return manager.get_term_cfg("stalled").func.seconds.unsqueeze(-1)


class smoothed_joint_velocity(VelocityFilter):
    """Exponential moving average of joint velocities, as in `standing_motion`, [N, J] rad/s."""

    _step = 0

    def __call__(self, env: ManagerBasedRlEnv) -> Tensor:
        # Observations may be computed more than once in a step.
        if env.common_step_counter != self._step:
            self._step = env.common_step_counter
            self.smoothed(env)
        return self._smoothed


class physical_parameters:
    """Random physical parameters of the robots, [N, 1 + 3 + 1 + 12 + 12].

    These are the change of the trunk's mass (kg), the offset of its centre of mass (m), the feet's
    friction, and stiffness and damping of the servos as ratios of the nominal ones. The ratios are
    1 for motors that are no servos.

    Parameters:
        trunk: The trunk's body.
        foot: Geoms of a foot, the first of which stands for all feet.
    """

    def __init__(self, cfg: ObservationTermCfg, env: ManagerBasedRlEnv) -> None:
        ids = env.scene["robot"].indexing
        self._body = ids.body_ids[cfg.params["trunk"].body_ids]
        self._geom = ids.geom_ids[cfg.params["foot"].geom_ids][:1]

    def __call__(
        self, env: ManagerBasedRlEnv, trunk: SceneEntityCfg, foot: SceneEntityCfg
    ) -> Tensor:
        model = env.sim.model
        nominal = env.sim.get_default_field
        body = self._body
        mass = model.body_mass[:, body] - nominal("body_mass")[body]
        com = model.body_ipos[:, body].flatten(1) - nominal("body_ipos")[body].flatten()
        stiffness = model.actuator_gainprm[:, :, 0] / nominal("actuator_gainprm")[:, 0]
        damping = model.actuator_biasprm[:, :, 2] / nominal("actuator_biasprm")[:, 2]
        # Motors whose torques are computed outside MuJoCo have no damping in its model: 0 / 0.
        damping = torch.where(damping.isnan(), 1.0, damping)
        friction = model.geom_friction[:, self._geom, 0]
        return torch.cat((mass, com, friction, stiffness, damping), dim=-1)
