"""mjlab's configuration of a robot, derived from its description."""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

from mjlab.actuator import BuiltinPositionActuatorCfg
from mjlab.asset_zoo.robots.unitree_go1 import go1_constants
from mjlab.entity import EntityArticulationInfoCfg, EntityCfg

from renet.robots import GO1, Robot
from renet.robots.model import load_robot_model

ACTION_CLIP = 4.8
"""Limit to which actions are clipped, in policy units: 1.2 rad of the Go1's joints (Extreme
Parkour)."""

VISUAL_GO1 = replace(GO1, spec=go1_constants.get_spec)
"""The Go1 as tasks train it: with mjlab's model, which has meshes to look at. The file of the
runtime was written from it, with six digits: their physics differ by parts in a million."""


def entity_cfg(robot: Robot) -> EntityCfg:
    """Build a new configuration of a robot for mjlab."""
    return EntityCfg(
        init_state=EntityCfg.InitialStateCfg(
            pos=(0.0, 0.0, robot.height), joint_pos=dict(robot.pose), joint_vel={".*": 0.0}
        ),
        spec_fn=partial(load_robot_model, robot),
        articulation=EntityArticulationInfoCfg(
            actuators=tuple(_servos(robot)),
            soft_joint_pos_limit_factor=0.9,
        ),
    )


def _servos(robot: Robot) -> Iterator[BuiltinPositionActuatorCfg]:
    """Yield a group of servos for each kind of motor."""
    # A dictionary removes equal motors and keeps their order.
    for motor in dict.fromkeys(robot.motors.values()):
        kinds = [kind for kind, other in robot.motors.items() if other == motor]
        yield BuiltinPositionActuatorCfg(
            target_names_expr=(f".*_({'|'.join(kinds)})_joint",),
            stiffness=robot.stiffness,
            damping=robot.damping,
            effort_limit=motor.torque,
        )
