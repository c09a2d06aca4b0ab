"""What a control step is judged by: the simulation's arrays as one Warp struct.

Observations, rewards, costs and reasons to end are functions of this struct and a robot's number
(`terms.py`), run by few kernels for all robots: on a GPU one launch instead of one for each
operation, on a CPU code that stays quick however seldom it runs.
"""

# Warp compiles annotations and arithmetic that pyright takes for Python's.
# pyright: reportGeneralTypeIssues=false, reportInvalidTypeForm=false, reportArgumentType=false
# pyright: reportCallIssue=false, reportOperatorIssue=false, reportReturnType=false

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import torch
import warp as wp
from torch import Tensor

from renet.interface import CONSTRAINTS, JOINTS, LEGS
from renet.tasks.sensors import CALF_CONTACT, FEET_CONTACT, THIGH_TRUNK_CONTACT
from renet.tasks.terrains import DIFFICULT

if TYPE_CHECKING:
    from renet.tasks.env import RenetEnv

COMMAND = "goal"
"""Name of the command term in every RENet task."""


@wp.struct
class Step:
    """Arrays of N robots, world frame, SI units; J joints in the MJCF's order, F feet."""

    # Where the simulation has arrived.
    qpos: wp.array2d(dtype=float)
    qvel: wp.array2d(dtype=float)
    position: wp.array2d(dtype=wp.vec3)
    """Of bodies."""
    rotation: wp.array2d(dtype=wp.mat33)
    """Of bodies, to world."""
    site: wp.array2d(dtype=wp.vec3)
    joint_force: wp.array2d(dtype=float)
    """Of actuators, by degree of freedom."""
    sensed: wp.array2d(dtype=float)
    """MuJoCo's sensors, at the last physics step's start."""

    # What was asked for.
    action: wp.array2d(dtype=float)
    action_before: wp.array2d(dtype=float)
    target: wp.array2d(dtype=float)
    """Of servos, rad [N, J]."""
    speed: wp.array(dtype=float)
    yaw: wp.array(dtype=float)
    command: wp.array2d(dtype=float)
    """As policies read it [N, 3]."""

    # The episode.
    origin: wp.array(dtype=wp.vec3)
    """The start on a robot's tile."""
    tile: wp.array(dtype=wp.int64)
    """Kind of a robot's tile."""
    length: wp.array(dtype=wp.int64)
    """Control steps so far."""
    begun: wp.array(dtype=wp.bool)
    """Whether this episode was judged before: what is remembered below is of it."""
    costs: wp.array2d(dtype=float)
    """Of constraints [N, 3]."""
    joint_velocity_before: wp.array2d(dtype=float)
    joint_velocity_smooth: wp.array2d(dtype=float)
    feet_before: wp.array2d(dtype=wp.vec3)
    stall_origin: wp.array(dtype=wp.vec2)
    stall_seconds: wp.array(dtype=float)

    # Which numbers are whose.
    base: int
    base_velocity: int
    """First of six degrees of freedom."""
    joint: wp.array(dtype=int)
    """Columns of `qpos` [J]."""
    joint_velocity: wp.array(dtype=int)
    """Columns of `qvel` and `joint_force` [J]."""
    order: wp.array(dtype=int)
    """Joints in the order of interface.JOINTS."""
    hip: wp.array(dtype=int)
    """Joints [4]."""
    foot: wp.array(dtype=int)
    """Sites [F]."""
    foot_contact: wp.array(dtype=int)
    """Columns of `sensed`."""
    body_contact: wp.array(dtype=int)
    """First of three columns of `sensed` for each thigh and the trunk."""
    calf_contact: wp.array2d(dtype=int)
    """The same for each calf's geoms [4, G]."""

    # What does not change.
    pose: wp.array2d(dtype=float)
    """Default joint positions [N, J]."""
    lowest: wp.array2d(dtype=float)
    """Soft limits of joint positions [N, J]."""
    highest: wp.array2d(dtype=float)
    fastest: wp.array(dtype=float)
    """Soft limits of joint speeds [J]."""
    strongest: wp.array(dtype=float)
    """Soft limits of joint torques [J]."""
    stiffness: float
    damping: float
    standing_height: float
    """Of the base over feet that stand, m."""
    longest: int
    """Control steps of an episode."""
    difficult: wp.array(dtype=float)
    """1 for each kind of tile that forces vision."""
    gap: int
    """Kind of tile that is a gap; -1 without any."""
    dt: float


def watch(env: RenetEnv) -> Any:
    """The struct of an environment whose commands and actions are loaded."""
    robot, data, device = env.scene["robot"], env.sim.wp_data, env.sim.wp_device
    own, entity = robot.indexing, robot.data
    joints = robot.joint_names

    def integers(values: Any) -> wp.array:
        return wp.array(torch.as_tensor(values).cpu().numpy(), dtype=int, device=device)

    def zeros(*shape: int, dtype: Any = float) -> wp.array:
        return wp.zeros(shape, dtype=dtype, device=device)

    def floats(values: Iterable[float]) -> wp.array:
        return wp.array(list(values), dtype=float, device=device)

    def per_joint(values: Tensor) -> wp.array:
        return wp.from_torch(values.expand(env.num_envs, -1).contiguous())

    step: Any = Step()
    step.qpos, step.qvel, step.joint_force = data.qpos, data.qvel, data.qfrc_actuator
    step.position, step.rotation, step.site = data.xpos, data.xmat, data.site_xpos
    step.sensed = data.sensordata

    goal = env.command_manager.get_term(COMMAND)
    step.action = wp.from_torch(env.action_manager.action)
    step.action_before = wp.from_torch(env.action_manager.prev_action)
    step.target = wp.from_torch(entity.joint_pos_target)
    step.speed, step.yaw = wp.from_torch(goal.speed), wp.from_torch(goal.yaw)
    step.command = wp.from_torch(goal.command)

    terrain = env.scene.terrain
    generator = terrain.cfg.terrain_generator if terrain is not None else None
    kinds = list(generator.sub_terrains) if generator is not None else []
    step.gap = kinds.index("gap") if "gap" in kinds else -1
    nowhere = zeros(env.num_envs, dtype=wp.int64)
    step.tile = wp.from_torch(terrain.terrain_types) if kinds else nowhere
    step.difficult = floats([kind in DIFFICULT for kind in kinds] or [False])
    step.origin = wp.from_torch(env.scene.env_origins, dtype=wp.vec3)
    step.length = wp.from_torch(env.episode_length_buf)
    step.begun = zeros(env.num_envs, dtype=wp.bool)
    step.costs = zeros(env.num_envs, len(CONSTRAINTS))
    step.joint_velocity_before = zeros(env.num_envs, len(joints))
    step.joint_velocity_smooth = zeros(env.num_envs, len(joints))
    step.feet_before = zeros(env.num_envs, len(LEGS), dtype=wp.vec3)
    step.stall_origin = zeros(env.num_envs, dtype=wp.vec2)
    step.stall_seconds = zeros(env.num_envs)

    step.base, step.base_velocity = int(own.root_body_id), int(own.free_joint_v_adr[0])
    step.joint, step.joint_velocity = integers(own.joint_q_adr), integers(own.joint_v_adr)
    step.order = integers(robot.find_joints(JOINTS, preserve_order=True)[0])
    step.hip = integers(robot.find_joints(".*_hip_joint")[0])
    feet, _ = robot.find_sites(LEGS, preserve_order=True)
    step.foot = integers(own.site_ids[feet])
    step.foot_contact = integers(_columns(env, FEET_CONTACT))
    step.body_contact = integers(_columns(env, THIGH_TRUNK_CONTACT))
    step.calf_contact = integers(_columns(env, CALF_CONTACT).view(len(LEGS), -1))

    kind, soft = env.cfg.robot, env.cfg.constraints
    low, high = entity.joint_pos_limits.unbind(-1)
    middle, reach = (low + high) / 2, soft.position * (high - low) / 2
    step.pose = per_joint(entity.default_joint_pos)
    step.lowest, step.highest = per_joint(middle - reach), per_joint(middle + reach)
    motors = [kind.motor(name) for name in joints]
    step.fastest = floats(soft.velocity * motor.velocity for motor in motors)
    step.strongest = floats(soft.torque * motor.torque for motor in motors)
    step.stiffness, step.damping = kind.stiffness, kind.damping
    step.standing_height = kind.map_height - kind.foot_radius
    step.longest, step.dt = env.max_episode_length, env.step_dt
    return step


def _columns(env: RenetEnv, sensor: str) -> Tensor:
    """Where a contact sensor's parts begin in `sensordata`."""
    views = [slot.data_view for slot in env.scene[sensor]._slots]
    return torch.tensor([view.storage_offset() for view in views])


@wp.func
def offset(step: Step, robot: int, joint: int) -> float:
    """Of a joint from its default position, rad."""
    return step.qpos[robot, step.joint[joint]] - step.pose[robot, joint]


@wp.func
def joint_speed(step: Step, robot: int, joint: int) -> float:
    """Velocity of a joint, rad/s."""
    return step.qvel[robot, step.joint_velocity[joint]]


@wp.func
def world_velocity(step: Step, robot: int) -> wp.vec3:
    """Of the base, m/s."""
    first = step.base_velocity
    return wp.vec3(
        step.qvel[robot, first], step.qvel[robot, first + 1], step.qvel[robot, first + 2]
    )


@wp.func
def heading(step: Step, robot: int) -> float:
    """Yaw of the base's forward axis, rad."""
    turned = step.rotation[robot, step.base]
    return wp.atan2(turned[1, 0], turned[0, 0])


@wp.func
def horizontal(vector: wp.vec3) -> wp.vec2:
    """Without its vertical part."""
    return wp.vec2(vector[0], vector[1])


@wp.func
def height(step: Step, robot: int) -> float:
    """Of the base over the start on its tile, m."""
    return step.position[robot, step.base][2] - step.origin[robot][2]


@wp.func
def touches(step: Step, robot: int, column: int, least: float) -> bool:
    """Whether a part's contact force exceeds `least`, N."""
    force = wp.vec3(
        step.sensed[robot, column], step.sensed[robot, column + 1], step.sensed[robot, column + 2]
    )
    return wp.length(force) > least
