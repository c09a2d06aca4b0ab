"""Observation terms: proprioception, true quantities for critics and estimators, and depth."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import torch
from mjlab.managers.scene_entity_config import SceneEntityCfg
from torch import Tensor

from renet.sim.depth_camera import DepthCamera
from renet.tasks.commands import COMMAND
from renet.tasks.terrains import DIFFICULT
from renet.vocabulary import JOINTS, PROPRIOCEPTION

if TYPE_CHECKING:
    from mjlab.envs import ManagerBasedRlEnv

DEPTH_CAMERA = "depth_camera"
HEIGHT_MAP = "height_map"
FEET_HEIGHT = "feet_height"
FEET_CONTACT = "feet_contact"
THIGH_TRUNK_CONTACT = "thigh_trunk_contact"
CALF_CONTACT = "calf_contact"


class Proprioception:
    """What the robot's own sensors say, order and units of vocabulary.PROPRIOCEPTION."""

    def __init__(self, cfg, env: ManagerBasedRlEnv) -> None:
        del cfg
        joints, _ = env.scene["robot"].find_joints(JOINTS, preserve_order=True)
        self._joints = torch.tensor(joints, device=env.device)

    def __call__(self, env: ManagerBasedRlEnv) -> Tensor:
        """[N, 45], before scaling."""
        data = env.scene["robot"].data
        terms = {
            "base_angular_velocity": data.root_link_ang_vel_b,
            "projected_gravity": data.projected_gravity_b,
            "command": env.command_manager.get_command(COMMAND),
            "joint_position": (data.joint_pos - data.default_joint_pos)[:, self._joints],
            "joint_velocity": data.joint_vel[:, self._joints],
            "last_action": env.action_manager.action,
        }
        return torch.cat([terms[term.name] for term in PROPRIOCEPTION], dim=-1)


def velocity(env: ManagerBasedRlEnv) -> Tensor:
    """True base linear velocity, [N, 3] m/s, base frame."""
    return env.scene["robot"].data.root_link_lin_vel_b


def sensor(env: ManagerBasedRlEnv, name: str) -> Tensor:
    """A terrain sensor's reading: height map [N, 132] or feet height [N, 4], m."""
    return env.scene[name].data


def depth(env: ManagerBasedRlEnv) -> Tensor:
    """Newest depth image, [N, 48, 64] float16 in [0, 1], held between 10 Hz ticks."""
    return cast(DepthCamera, env.scene[DEPTH_CAMERA]).normalised()


def feet_contact(env: ManagerBasedRlEnv) -> Tensor:
    """1 where a foot touches, [N, 4]."""
    return (env.scene[FEET_CONTACT].data.found > 0).float()


class Difficult:
    """1 where the tile forces vision."""

    def __init__(self, cfg, env: ManagerBasedRlEnv) -> None:
        del cfg
        terrain = env.scene.terrain
        generator = terrain.cfg.terrain_generator if terrain else None
        kinds = generator.sub_terrains if generator else ()
        self._hard = torch.tensor([[float(kind in DIFFICULT)] for kind in kinds], device=env.device)

    def __call__(self, env: ManagerBasedRlEnv) -> Tensor:
        """[N, 1]."""
        terrain = env.scene.terrain
        if terrain is None or not len(self._hard):
            return torch.zeros(env.num_envs, 1, device=env.device)
        return self._hard[terrain.terrain_types]


class PhysicalParameters:
    """What randomisation drew: trunk mass change (kg), CoM offset (m), foot friction, servo gains.

    [N, 1 + 3 + 1 + 12 + 12], gains as a ratio of the nominal ones. Events change them at most at a
    reset, so they are gathered anew only then.
    """

    def __init__(self, cfg, env: ManagerBasedRlEnv) -> None:
        del cfg, env
        self._gathered: Tensor | None = None

    def __call__(
        self, env: ManagerBasedRlEnv, trunk: SceneEntityCfg, foot: SceneEntityCfg
    ) -> Tensor:
        """[N, 29]."""
        if self._gathered is None:
            self._gathered = self._gather(env, trunk, foot)
        return self._gathered

    def reset(self, env_ids: Tensor | slice | None = None) -> None:
        """Parameters may have been drawn again."""
        del env_ids
        self._gathered = None

    @staticmethod
    def _gather(env: ManagerBasedRlEnv, trunk: SceneEntityCfg, foot: SceneEntityCfg) -> Tensor:
        robot, model, nominal = env.scene["robot"], env.sim.model, env.sim.get_default_field
        body = robot.indexing.body_ids[trunk.body_ids]
        geom = robot.indexing.geom_ids[foot.geom_ids][:1]
        mass = model.body_mass[:, body] - nominal("body_mass")[body]
        com = model.body_ipos[:, body].flatten(1) - nominal("body_ipos")[body].flatten()
        stiffness = model.actuator_gainprm[:, :, 0] / nominal("actuator_gainprm")[:, 0]
        damping = model.actuator_biasprm[:, :, 2] / nominal("actuator_biasprm")[:, 2]
        friction = model.geom_friction[:, geom, 0]
        return torch.cat((mass, com, friction, stiffness, damping), dim=-1)
