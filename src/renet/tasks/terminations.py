"""When an episode ends; leaving the tile is success, hence a time-out, not a failure."""

# Warp compiles annotations and arithmetic that pyright takes for Python's.
# pyright: reportGeneralTypeIssues=false, reportInvalidTypeForm=false, reportArgumentType=false
# pyright: reportCallIssue=false, reportOperatorIssue=false, reportReturnType=false

from __future__ import annotations

import warp as wp

from renet.tasks.step import Step, height, horizontal
from renet.tasks.terms import per_robot
from renet.tiles import TILE

TILT = wp.constant(-0.17)
"""Vertical part of gravity in the base frame above which the robot lies: tilted over 80 degrees."""
PIT_DEPTH = wp.constant(0.25)
"""Metres below the tile's start at which the base is in a gap, not above it."""
MAP_DEPTH = wp.constant(3.0)
"""Metres below a tile's start at which there is no ground: the highest stairs go 2.1 m down."""
PATIENCE = wp.constant(3.0)
"""Seconds in which a robot that is told to walk must make PROGRESS."""
PROGRESS = wp.constant(0.15)
"""Metres."""
HALF_TILE = wp.constant(TILE / 2)


@per_robot
def time_out(step: Step, robot: int) -> bool:
    """The episode has lasted as long as one does."""
    return int(step.length[robot]) >= step.longest


@per_robot
def fallen(step: Step, robot: int) -> bool:
    """Rolled or pitched over."""
    return -step.rotation[robot, step.base][2, 2] > TILT


@per_robot
def not_finite(step: Step, robot: int) -> bool:
    """NaN or infinity in the physics state, which those of forces end in: one makes the sum so."""
    total = wp.float32(0.0)
    for i in range(step.qpos.shape[1]):
        total += step.qpos[robot, i]
    for i in range(step.qvel.shape[1]):
        total += step.qvel[robot, i]
    return not wp.isfinite(total)


@per_robot
def in_gap(step: Step, robot: int) -> bool:
    """Base below the surface of a gap tile."""
    return int(step.tile[robot]) == step.gap and height(step, robot) < -PIT_DEPTH


@per_robot
def below_map(step: Step, robot: int) -> bool:
    """Base below everything a robot can stand on: it was pressed through the ground."""
    return height(step, robot) < -MAP_DEPTH


@wp.func
def from_middle(step: Step, robot: int) -> float:
    """Distance from the tile's middle in the tile's (square) norm, m."""
    away = step.position[robot, step.base] - step.origin[robot]
    return wp.max(wp.abs(away[0]), wp.abs(away[1]))


@per_robot
def left_tile(step: Step, robot: int) -> bool:
    """Walked off its tile in any direction."""
    return from_middle(step, robot) > HALF_TILE


@per_robot
def stalled(step: Step, robot: int) -> bool:
    """Stands where it was told to walk.

    Training only. Giving up in front of a stair otherwise earns the yaw reward for the rest of the
    episode, safer than any attempt to climb.
    """
    at = horizontal(step.position[robot, step.base])
    near = step.begun[robot] and wp.length(at - step.stall_origin[robot]) < PROGRESS
    if near and step.speed[robot] > 0.0:
        step.stall_seconds[robot] += step.dt
    else:
        step.stall_origin[robot] = at
        step.stall_seconds[robot] = 0.0
    return step.stall_seconds[robot] > PATIENCE
