"""The stranger: the policy's robot with all lengths a tenth larger, unknown to its training."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from renet.robots import Robot
from renet.robots.model import load_robot_model

_GROWTH = 1.1
"""Length of the stranger's parts relative to the robot's."""


def stranger(robot: Robot, factor: float = _GROWTH) -> Robot:
    """Return a robot with every length multiplied by a factor; density, motors and gains stay."""

    def spec() -> mujoco.MjSpec:
        return grow(load_robot_model(robot), factor)

    position = tuple(factor * x for x in robot.camera.position)
    return replace(
        robot,
        spec=spec,
        height=factor * robot.height,
        foot_radius=factor * robot.foot_radius,
        map_height=factor * robot.map_height,
        camera=replace(robot.camera, position=position),
    )


def grow(spec: mujoco.MjSpec, factor: float) -> mujoco.MjSpec:
    """Multiply every length of a robot's MJCF, in place; masses grow with volume."""
    # Masses grow with the third power of length, inertias with the fifth.
    for mesh in spec.meshes:
        mesh.scale = factor * np.array(mesh.scale)
    for body in spec.bodies:
        body.pos = factor * np.array(body.pos)
        body.ipos = factor * np.array(body.ipos)
        body.mass *= factor**3
        body.inertia = factor**5 * np.array(body.inertia)
        body.fullinertia = factor**5 * np.array(body.fullinertia)
    for geom in spec.geoms:
        geom.pos = factor * np.array(geom.pos)
        geom.size = factor * np.array(geom.size)
        geom.fromto = factor * np.array(geom.fromto)
        geom.mass *= factor**3
    for part in (*spec.sites, *spec.joints):
        part.pos = factor * np.array(part.pos)
    return spec
