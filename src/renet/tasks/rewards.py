"""The paper's rewards (RENet, Method A, footnote, and eq. 6); scales are in config.py.

World-frame quantities use the horizontal plane: <v, n_yaw> has no vertical part.
"""

# Warp compiles annotations and arithmetic that pyright takes for Python's.
# pyright: reportGeneralTypeIssues=false, reportInvalidTypeForm=false, reportArgumentType=false
# pyright: reportCallIssue=false, reportOperatorIssue=false, reportReturnType=false

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
import warp as wp
from torch import Tensor

from renet.interface import HEIGHT_MAP_X, HEIGHT_MAP_Y
from renet.tasks.sensors import HEIGHT_MAP
from renet.tasks.step import (
    COMMAND,
    Step,
    heading,
    horizontal,
    joint_speed,
    offset,
    touches,
    world_velocity,
)
from renet.tasks.terms import per_robot

if TYPE_CHECKING:
    from renet.tasks.env import RenetEnv

CONTACT_FORCE = wp.constant(0.1)
"""N above which a touch is a collision (Extreme Parkour)."""
SMOOTHING = wp.constant(0.2)
"""Time constant of joint velocities by which standing is judged, s."""
LIFT = wp.constant(0.12)
"""Wanted of a foot in swing, m."""


@per_robot
def linear_velocity(step: Step, robot: int) -> float:
    """Goal-guided linear velocity tracking, r_lin_vel (RENet eq. 6).

    At most 1: there is no bonus, and no penalty, for overshooting.
    """
    velocity = horizontal(world_velocity(step, robot))
    speed = step.speed[robot]
    if speed > 0.0:
        direction = wp.vec2(wp.cos(step.yaw[robot]), wp.sin(step.yaw[robot]))
        return wp.min(wp.dot(velocity, direction), speed) / (speed + 1.0e-5)
    return 1.0 / (1.0 + wp.length(velocity))


@per_robot
def yaw(step: Step, robot: int) -> float:
    """exp(-|c_yaw - yaw|): angular tracking in Extreme Parkour's form."""
    error = step.yaw[robot] - heading(step, robot)
    return wp.exp(-wp.abs(wp.atan2(wp.sin(error), wp.cos(error))))


@per_robot
def collision(step: Step, robot: int) -> float:
    """Number of thighs, calves and trunk in contact, whatever the number of geoms."""
    count = wp.float32(0.0)
    for body in range(step.body_contact.shape[0]):
        if touches(step, robot, step.body_contact[body], CONTACT_FORCE):
            count += 1.0
    for calf in range(step.calf_contact.shape[0]):
        geoms = wp.int32(0)
        for geom in range(step.calf_contact.shape[1]):
            if touches(step, robot, step.calf_contact[calf, geom], CONTACT_FORCE):
                geoms += 1
        if geoms > 0:
            count += 1.0
    return count


@per_robot
def joint_energy(step: Step, robot: int) -> float:
    """Sum of |torque * joint velocity|, W (our reading of "joint energy")."""
    power = wp.float32(0.0)
    for joint in range(step.joint.shape[0]):
        torque = step.joint_force[robot, step.joint_velocity[joint]]
        power += wp.abs(torque * joint_speed(step, robot, joint))
    return power


@per_robot
def action_rate(step: Step, robot: int) -> float:
    """Euclidean norm of the change of action (Extreme Parkour: not squared)."""
    squares = wp.float32(0.0)
    for i in range(step.action.shape[1]):
        change = step.action[robot, i] - step.action_before[robot, i]
        squares += change * change
    return wp.sqrt(squares)


@per_robot
def default_position(step: Step, robot: int) -> float:
    """Squared distance of all joints to the default pose, rad^2."""
    squares = wp.float32(0.0)
    for joint in range(step.joint.shape[0]):
        squares += wp.pow(offset(step, robot, joint), 2.0)
    return squares


@per_robot
def hip_position(step: Step, robot: int) -> float:
    """Squared distance of the hips to the default pose, rad^2."""
    squares = wp.float32(0.0)
    for hip in range(step.hip.shape[0]):
        squares += wp.pow(offset(step, robot, step.hip[hip]), 2.0)
    return squares


@per_robot
def joint_acceleration(step: Step, robot: int) -> float:
    """Sum of squared joint accelerations from control-step differences, (rad/s^2)^2.

    An episode starts at rest.
    """
    squares = wp.float32(0.0)
    for joint in range(step.joint.shape[0]):
        before = wp.float32(0.0)
        if step.begun[robot]:
            before = step.joint_velocity_before[robot, joint]
        now = joint_speed(step, robot, joint)
        squares += wp.pow((now - before) / step.dt, 2.0)
        step.joint_velocity_before[robot, joint] = now
    return squares


@per_robot
def orientation(step: Step, robot: int) -> float:
    """Squared horizontal part of gravity in the base frame: sin^2 of the tilt."""
    tilt = step.rotation[robot, step.base]
    return tilt[2, 0] * tilt[2, 0] + tilt[2, 1] * tilt[2, 1]


@per_robot
def standing_motion(step: Step, robot: int) -> float:
    """Sum of squared, smoothed joint velocities of robots told to stand, (rad/s)^2.

    Not in the paper, whose reward is all but flat at rest: 7 cm/s of creeping cost it 7 %.
    Smoothed, because exploration shakes the joints as fast as steps move them, but to and fro.
    """
    squares = wp.float32(0.0)
    for joint in range(step.joint.shape[0]):
        smooth = wp.float32(0.0)
        if step.begun[robot]:
            smooth = step.joint_velocity_smooth[robot, joint]
        smooth += (joint_speed(step, robot, joint) - smooth) * step.dt / SMOOTHING
        step.joint_velocity_smooth[robot, joint] = smooth
        squares += smooth * smooth
    if step.speed[robot] > 0.0:
        return 0.0
    return squares


@per_robot
def foot_clearance(step: Step, robot: int) -> float:
    """Low feet that move: lack of lift squared times horizontal speed, summed over feet, m^3/s.

    Not in the paper (HIMLoco rewards clearance likewise): millions of steps on a CPU, instead of
    billions on a GPU, otherwise end in a shuffle that trips over the first stair. Lift is measured
    against the trunk, so that it means the same on stairs.
    """
    ground = step.position[robot, step.base][2] - step.standing_height
    total = wp.float32(0.0)
    for foot in range(step.foot.shape[0]):
        at = step.site[robot, step.foot[foot]]
        lack = wp.clamp(LIFT - (at[2] - ground), 0.0, LIFT)
        if step.begun[robot]:
            moved = at - step.feet_before[robot, foot]
            total += lack * lack * wp.length(horizontal(moved)) / step.dt
        step.feet_before[robot, foot] = at
    return total


def overspeed(env: RenetEnv, tolerance: float = 0.2) -> Tensor:
    """Speed towards the goal beyond c_x by more than a share `tolerance`, [N] m/s.

    Not in the paper, whose reward does not mind overshoot (eq. 6): early in training the policy
    otherwise runs at one speed, whatever it is asked for. Robots told to stand pay nothing here.
    """
    goal = env.command_manager.get_term(COMMAND)
    velocity = env.scene["robot"].data.root_link_lin_vel_w[:, :2]
    towards = (velocity * goal.direction).sum(-1)  # type: ignore[attr-defined]
    speed: Tensor = goal.speed  # type: ignore[attr-defined]
    return torch.relu(towards - (1.0 + tolerance) * speed) * (speed > 0)


def low_trunk(env: RenetEnv, height: float = 0.27, reach: float = 0.16) -> Tensor:
    """Square of what the trunk lacks to a height over the ground below it, [N] m^2.

    Not in the paper: without it the policy crouches at 0.21 to 0.23 m.

    Args:
        env: environment with the height-map sensor.
        height: wanted of the base over the mean ground below it, m.
        reach: half-width of the square of the map that counts as below, m.
    """
    sensor = env.scene[HEIGHT_MAP]
    below = [abs(x) < reach and abs(y) < reach for x in HEIGHT_MAP_X for y in HEIGHT_MAP_Y]
    columns = [index for index, inside in enumerate(below) if inside]
    above_ground = sensor.data[:, columns].mean(-1) + sensor.cfg.base_height
    return torch.relu(height - above_ground).square()
