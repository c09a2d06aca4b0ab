"""Observation terms: proprioception, true quantities for critics and estimators, and depth."""

# Warp compiles annotations and arithmetic that pyright takes for Python's.
# pyright: reportGeneralTypeIssues=false, reportInvalidTypeForm=false, reportArgumentType=false
# pyright: reportCallIssue=false, reportOperatorIssue=false, reportReturnType=false

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import torch
import warp as wp
from mjlab.managers.scene_entity_config import SceneEntityCfg
from torch import Tensor

from renet.interface import FEET, PROPRIOCEPTION_SIZE
from renet.sim.depth.camera import DepthCamera
from renet.tasks.sensors import DEPTH_CAMERA
from renet.tasks.step import Step, joint_speed, offset, world_velocity
from renet.tasks.terms import fills

if TYPE_CHECKING:
    from mjlab.envs import ManagerBasedRlEnv

    from renet.tasks.env import RenetEnv


@fills(PROPRIOCEPTION_SIZE)
def proprioception(step: Step, robot: int, row: wp.array2d(dtype=float), first: int):
    """What the robot's own sensors say, order and units of interface.PROPRIOCEPTION.

    [N, 45], before scaling.
    """
    down = step.rotation[robot, step.base]
    for i in range(3):
        row[robot, first + i] = step.qvel[robot, step.base_velocity + 3 + i]
        row[robot, first + 3 + i] = -down[2, i]
        row[robot, first + 6 + i] = step.command[robot, i]
    count = step.order.shape[0]
    for i in range(count):
        joint = step.order[i]
        row[robot, first + 9 + i] = offset(step, robot, joint)
        row[robot, first + 9 + count + i] = joint_speed(step, robot, joint)
        row[robot, first + 9 + 2 * count + i] = step.action[robot, i]


@fills(3)
def velocity(step: Step, robot: int, row: wp.array2d(dtype=float), first: int):
    """True base linear velocity, [N, 3] m/s, base frame."""
    turned = wp.transpose(step.rotation[robot, step.base])
    own = turned * world_velocity(step, robot)
    for i in range(3):
        row[robot, first + i] = own[i]


def sensor(env: ManagerBasedRlEnv, name: str) -> Tensor:
    """A terrain sensor's reading: height map [N, 132] or feet height [N, 4], m."""
    return env.scene[name].data


def depth(env: ManagerBasedRlEnv) -> Tensor:
    """Newest depth image, [N, 48, 64] float16 in [0, 1], held between 10 Hz ticks."""
    return cast(DepthCamera, env.scene[DEPTH_CAMERA]).normalised()


@fills(FEET)
def feet_contact(step: Step, robot: int, row: wp.array2d(dtype=float), first: int):
    """1 where a foot touches, [N, 4]."""
    for foot in range(step.foot_contact.shape[0]):
        found = step.sensed[robot, step.foot_contact[foot]] > 0.0
        row[robot, first + foot] = wp.where(found, 1.0, 0.0)


@fills(1)
def difficult(step: Step, robot: int, row: wp.array2d(dtype=float), first: int):
    """1 where the tile forces vision, [N, 1]."""
    row[robot, first] = step.difficult[int(step.tile[robot])]


def stalled_seconds(env: RenetEnv) -> Tensor:
    """Seconds since the robot last made progress: `terminations.stalled` ends the episode at 3.

    [N, 1].
    """
    return wp.to_torch(env.watched.stall_seconds).unsqueeze(-1)


def smoothed_joint_velocity(env: RenetEnv) -> Tensor:
    """Joint velocities as the reward `standing_motion` smooths them, [N, J] rad/s."""
    return wp.to_torch(env.watched.joint_velocity_smooth)


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
