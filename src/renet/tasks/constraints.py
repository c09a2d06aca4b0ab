"""Constraint costs of the cMDP: joint position, joint velocity, torque (RENet, Method A).

Each is zero for motion inside its soft limit. Torque is judged before the actuator saturates:
clipped torque never violates anything.
"""

# Warp compiles annotations and arithmetic that pyright takes for Python's.
# pyright: reportGeneralTypeIssues=false, reportInvalidTypeForm=false, reportArgumentType=false
# pyright: reportCallIssue=false, reportOperatorIssue=false, reportReturnType=false

from __future__ import annotations

from dataclasses import dataclass

import warp as wp

from renet.interface import CONSTRAINTS
from renet.tasks.step import Step, joint_speed
from renet.tasks.terms import per_robot


@dataclass
class ConstraintCfg:
    """Soft fractions of the hard limits above which a joint costs."""

    position: float = 0.9
    """Share of the joint range, as the robot's soft limits."""
    velocity: float = 0.8
    """Share of the motor's speed limit."""
    torque: float = 0.8
    """Share of the motor's effort limit."""


@wp.func
def constraint_costs(step: Step, robot: int) -> wp.vec3:
    """Sums over joints of what is beyond a limit, order of interface.CONSTRAINTS.

    In rad, rad/s (each joint counts at most 1) and N m. Torque is what the nominal gains ask for,
    whatever gains a robot's servos have drawn.
    """
    position, velocity, torque = wp.float32(0.0), wp.float32(0.0), wp.float32(0.0)
    for joint in range(step.joint.shape[0]):
        angle = step.qpos[robot, step.joint[joint]]
        speed = joint_speed(step, robot, joint)
        asked = step.stiffness * (step.target[robot, joint] - angle) - step.damping * speed
        position += wp.max(step.lowest[robot, joint] - angle, 0.0)
        position += wp.max(angle - step.highest[robot, joint], 0.0)
        velocity += wp.clamp(wp.abs(speed) - step.fastest[joint], 0.0, 1.0)
        torque += wp.max(wp.abs(asked) - step.strongest[joint], 0.0)
    return wp.vec3(position, velocity, torque)


@per_robot
def position_violated(step: Step, robot: int) -> float:
    """1 where the joint positions cost something in this step."""
    return wp.where(step.costs[robot, 0] > 0.0, 1.0, 0.0)


@per_robot
def velocity_violated(step: Step, robot: int) -> float:
    """1 where the joint velocities cost something in this step."""
    return wp.where(step.costs[robot, 1] > 0.0, 1.0, 0.0)


@per_robot
def torque_violated(step: Step, robot: int) -> float:
    """1 where the torques cost something in this step."""
    return wp.where(step.costs[robot, 2] > 0.0, 1.0, 0.0)


VIOLATED = dict(
    zip(CONSTRAINTS, (position_violated, velocity_violated, torque_violated), strict=True)
)
"""Terms by the name of the constraint."""
