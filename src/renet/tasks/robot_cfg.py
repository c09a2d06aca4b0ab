"""What the tasks need to know of a robot. The Go1 and the Go2 are in config/."""

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

import mujoco
from mjlab.actuator import BuiltinPositionActuatorCfg
from mjlab.entity import EntityArticulationInfoCfg, EntityCfg
from mjlab.utils.spec_config import CollisionCfg

from renet.errors import RenetError
from renet.interface import JOINTS, LEGS, MAP_HEIGHT, TRUNK
from renet.sim.depth.camera import MountCfg

PARTS = ("hip", "thigh", "calf")
BODIES = (TRUNK, *(f"{leg}_{part}" for leg in LEGS for part in PARTS))
"""Names of all bodies the tasks look for."""
FEET = tuple(f"{leg}_foot_collision" for leg in LEGS)
"""Names of the feet's geoms; a site at each foot's middle is named as its leg."""
CALVES = tuple(rf"{leg}_calf_collision\d*" for leg in LEGS)
"""Patterns of the calves' other colliding geoms."""
ACTION_CLIP = 4.8
"""Policy units beyond which actions are cut: 1.2 rad of the Go1's joints (Extreme Parkour)."""

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


@dataclass(frozen=True)
class Motor:
    """What drives a joint, from the vendor's model."""

    torque: float
    """Limit, N m."""
    velocity: float
    """Limit, rad/s."""
    armature: float | None = None
    """Reflected rotor inertia, kg m^2; None keeps the MJCF's."""


@dataclass(frozen=True)
class RobotCfg:
    """A quadruped of twelve joints."""

    name: str
    """As bundles show it."""
    spec: Callable[[], mujoco.MjSpec]
    """A fresh MJCF in renet's names (see `rename_parts`): bodies `trunk`, `FR_hip`, `FR_thigh`,
    `FR_calf`, …, the joints of interface.JOINTS in any order, colliding geoms `*_collision*`,
    feet `FR_foot_collision`, …, with a site `FR`, … in the middle of each; no actuators.
    All calves have equally many colliding geoms, at least one beside the foot."""
    height: float
    """Height of the base above flat ground at the start, m."""
    pose: Mapping[str, float]
    """Default joint positions, rad, by regular expression over interface.JOINTS."""
    motors: Mapping[str, Motor]
    """Motors of the `hip`, `thigh` and `calf` joints."""
    foot_radius: float
    """m"""
    camera: MountCfg = field(default_factory=MountCfg)
    """Where the depth camera sits on the trunk."""
    stiffness: float = 40.0
    """Kp of every joint, N m/rad."""
    damping: float = 1.0
    """Kd of every joint, N m s/rad."""
    action_scale: float = 0.25
    """Radians of joint target per policy unit."""
    map_height: float = MAP_HEIGHT
    """Height of the base over flat ground that reads as zero in the height map, m."""

    def entity(self) -> EntityCfg:
        """A fresh configuration for mjlab."""
        return EntityCfg(
            init_state=EntityCfg.InitialStateCfg(
                pos=(0.0, 0.0, self.height), joint_pos=dict(self.pose), joint_vel={".*": 0.0}
            ),
            collisions=(COLLISION,),
            spec_fn=self.checked_spec,
            articulation=EntityArticulationInfoCfg(
                actuators=tuple(self._servos()),
                soft_joint_pos_limit_factor=0.9,
            ),
        )

    def checked_spec(self) -> mujoco.MjSpec:
        """A fresh MJCF with all that tasks look for; raises RenetError naming what is not there."""
        if set(self.motors) != set(PARTS):
            raise RenetError(f"motors must be of {', '.join(PARTS)}, not {', '.join(self.motors)}")
        spec = self.spec()
        parts = (spec.body, BODIES), (spec.joint, JOINTS), (spec.geom, FEET), (spec.site, LEGS)
        for lookup, names in parts:
            for name in names:
                _part(lookup, name)
        demand_joints(spec)
        if free := [name for name in JOINTS if not _limited(spec.joint(name))]:
            raise RenetError(
                f"the robot's MJCF gives {', '.join(free)} no limits: set the joint's `range` in "
                "RobotCfg.spec, since position costs and bundles need it"
            )
        calves = [sum(bool(re.fullmatch(calf, g.name)) for g in spec.geoms) for calf in CALVES]
        if 0 in calves or len(set(calves)) > 1:
            counts = ", ".join(f"{leg} {n}" for leg, n in zip(LEGS, calves, strict=True))
            raise RenetError(
                f"calves must have equally many colliding geoms beside the foot, not none: {counts}"
            )
        for geom in spec.geoms:
            geom.margin = 0.0  # MuJoCo Warp refuses any between boxes, which tiles are made of.
        return spec

    def motor(self, joint: str) -> Motor:
        """What drives a joint of interface.JOINTS."""
        return self.motors[joint.split("_")[1]]

    def _servos(self) -> Iterator[BuiltinPositionActuatorCfg]:
        """One group for each kind of motor."""
        for motor in dict.fromkeys(self.motors.values()):
            kinds = [kind for kind, other in self.motors.items() if other == motor]
            yield BuiltinPositionActuatorCfg(
                target_names_expr=(f".*_({'|'.join(kinds)})_joint",),
                stiffness=self.stiffness,
                damping=self.damping,
                effort_limit=motor.torque,
                armature=motor.armature,
            )


def demand_joints(spec: mujoco.MjSpec) -> None:
    """Raise RenetError unless a robot's trunk is free and its only other joints are JOINTS."""
    free = mujoco.mjtJoint.mjJNT_FREE
    floating = [joint.parent.name for joint in spec.joints if joint.type == free]
    if floating != [TRUNK]:
        where = ", ".join(floating) or "none"
        raise RenetError(
            f"the robot's MJCF must have one free joint, on its body {TRUNK}, not on {where}: add "
            "<freejoint/> to that body, and remove others"
        )
    moving = (joint.name or "one without a name" for joint in spec.joints if joint.type != free)
    if others := [name for name in moving if name not in JOINTS]:
        raise RenetError(
            f"the robot's MJCF has other joints than the {len(JOINTS)} of its legs: "
            f"{', '.join(others)}. Policies drive legs alone: remove these (wheels, arms), so that "
            "what they carry is fixed"
        )


def rename_parts(
    spec: mujoco.MjSpec,
    trunk: str,
    feet: Mapping[str, str],
    bodies: Mapping[str, str] | None = None,
    joints: Mapping[str, str] | None = None,
) -> mujoco.MjSpec:
    """Turn a vendor's MJCF into what `RobotCfg.spec` promises, in place.

    Args:
        spec: the robot alone, without ground; raises RenetError if it lacks a part.
        trunk: its name of the base body.
        feet: its names of the feet's geoms, by leg of interface.LEGS. A body's name stands for its
            lowest geom that collides, as vendors leave some without a name.
        bodies: its name of each body FR_hip, FR_thigh, FR_calf, …, where it is another.
        joints: its name of each joint of interface.JOINTS, where it is another.
    """
    vendor_names = {TRUNK: trunk, **(bodies or {}), **(joints or {})}
    parts = {}
    for lookup, names in ((spec.body, BODIES), (spec.joint, JOINTS)):
        parts |= {name: _part(lookup, vendor_names.get(name, name)) for name in names}
    for name, part in parts.items():
        part.name = name
    # Servos are mjlab's; physics options and poses are the task's.
    spec.option = mujoco.MjSpec().option
    for group in (spec.actuators, spec.sensors, spec.keys):
        for item in list(group):
            spec.delete(item)
    if set(feet) != set(LEGS):
        raise RenetError(f"feet must be of {', '.join(LEGS)}, not {', '.join(feet) or 'none'}")
    for leg, foot in feet.items():
        geom = _foot(spec, foot)
        if (site := spec.site(leg)) is not None:  # A vendor's, which may be anywhere.
            spec.delete(site)
        geom.parent.add_site(name=leg, pos=geom.pos)
        geom.name = f"{leg}_foot_collision"
    for body in spec.bodies:
        colliding = [geom for geom in body.geoms if geom.contype or geom.conaffinity]
        for number, geom in enumerate((g for g in colliding if g.name not in FEET), start=1):
            geom.name = f"{body.name}_collision{number}"
    return spec


def _foot(spec: mujoco.MjSpec, name: str) -> mujoco.MjsGeom:
    """The geom of a foot, by its name or by that of a body, whose lowest one it is."""
    body = spec.body(name)
    if spec.geom(name) is not None or body is None:
        return _part(spec.geom, name)
    colliding = [geom for geom in body.geoms if geom.contype or geom.conaffinity]
    if not colliding:
        raise RenetError(f"the robot's MJCF has no geom that collides on the body {name!r}")
    return min(colliding, key=lambda geom: geom.pos[2])


def _limited(joint: mujoco.MjsJoint) -> bool:
    """Whether a joint has limits; where its MJCF does not say so, MuJoCo goes by the range."""
    low, high = joint.range
    auto = joint.limited == mujoco.mjtLimited.mjLIMITED_AUTO
    return low < high if auto else bool(joint.limited)


def _part(lookup: Callable, name: str):
    """A named part of a spec."""
    part = lookup(name)
    if part is None:
        raise RenetError(f"the robot's MJCF has no {lookup.__name__} named {name!r}")
    return part
