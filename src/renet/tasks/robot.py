"""Unitree Go1 as RENet drives it: mjlab's asset, soft joint servos, feet-terrain contacts only."""

from __future__ import annotations

from mjlab.actuator import BuiltinPositionActuatorCfg
from mjlab.asset_zoo.robots.unitree_go1 import go1_constants as go1
from mjlab.entity import EntityArticulationInfoCfg, EntityCfg
from mjlab.utils.spec_config import CollisionCfg

STIFFNESS = 40.0
"""Kp, N m/rad (published Go1 parkour policies)."""
DAMPING = 1.0
"""Kd, N m s/rad."""
ACTION_SCALE = 0.25
"""Radians of joint target per policy unit."""
ACTION_CLIP = 4.8
"""Policy units beyond which actions are cut: 1.2 rad (Extreme Parkour)."""

TORQUE_LIMIT = {
    "hip": go1.HIP_ACTUATOR.effort_limit,
    "thigh": go1.HIP_ACTUATOR.effort_limit,
    "calf": go1.KNEE_ACTUATOR.effort_limit,
}
"""N m, from the vendor's model."""
VELOCITY_LIMIT = {
    "hip": go1.HIP_ACTUATOR.velocity_limit,
    "thigh": go1.HIP_ACTUATOR.velocity_limit,
    "calf": go1.KNEE_ACTUATOR.velocity_limit,
}
"""rad/s, from the vendor's model."""

# Robot geoms touch the terrain (contype 1) but not each other: self-collision costs a third of the
# physics and a policy inside its joint limits does not need it.
COLLISION = CollisionCfg(
    geom_names_expr=(r".*_collision\d*",),
    contype=0,
    conaffinity=1,
    condim={r".*_foot_collision": 3, r".*_collision\d*": 1},
    priority={r".*_foot_collision": 1, r".*_collision\d*": 0},
    friction={r".*_foot_collision": (1.0,)},
)


def _servo(joint: str, actuator: go1.ElectricActuator) -> BuiltinPositionActuatorCfg:
    return BuiltinPositionActuatorCfg(
        target_names_expr=(joint,),
        stiffness=STIFFNESS,
        damping=DAMPING,
        effort_limit=actuator.effort_limit,
        armature=actuator.reflected_inertia,
    )


def go1_cfg() -> EntityCfg:
    """A fresh robot configuration."""
    return EntityCfg(
        init_state=go1.INIT_STATE,
        collisions=(COLLISION,),
        spec_fn=go1.get_spec,
        articulation=EntityArticulationInfoCfg(
            actuators=(
                _servo(".*_(hip|thigh)_joint", go1.HIP_ACTUATOR),
                _servo(".*_calf_joint", go1.KNEE_ACTUATOR),
            ),
            soft_joint_pos_limit_factor=0.9,
        ),
    )
