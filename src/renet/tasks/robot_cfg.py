"""Configuration of robots. Those of the Go1 and the Go2 are in config/."""

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

LEG_PARTS = ("hip", "thigh", "calf")
BODIES = (TRUNK, *(f"{leg}_{part}" for leg in LEGS for part in LEG_PARTS))
"""Names of all bodies that tasks use."""
FEET = tuple(f"{leg}_foot_collision" for leg in LEGS)
"""Names of the feet's geoms. A site at the centre of each foot has the name of its leg."""
CALVES = tuple(rf"{leg}_calf_collision\d*" for leg in LEGS)
"""Patterns of the calves' other colliding geoms."""
ACTION_CLIP = 4.8
"""Limit to which actions are clipped, in policy units: 1.2 rad of the Go1's joints (Extreme
Parkour)."""

# The robot's geoms touch the terrain (contype 1) but not each other. Self-collision takes a third
# of the time of the physics, and a policy inside its joint limits does not need it.
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
    """Motor of a joint, from the vendor's model."""

    torque: float
    """Largest torque, N m."""
    velocity: float
    """Largest velocity, rad/s."""
    armature: float | None = None
    """Reflected inertia of the rotor, kg m^2; None keeps the MJCF's."""


@dataclass(frozen=True)
class RobotCfg:
    """Quadruped of twelve joints."""

    name: str
    """Name in bundles."""
    spec: Callable[[], mujoco.MjSpec]
    """Function that returns a new MJCF in renet's names (see `rename_parts`): bodies `trunk`,
    `FR_hip`, `FR_thigh`, `FR_calf`, …; the joints of interface.JOINTS in any order; colliding geoms
    `*_collision*`; feet `FR_foot_collision`, …, with a site `FR`, … at the centre of each; no
    actuators. All calves have the same number of colliding geoms, at least one beside the foot."""
    height: float
    """Height of the base above flat ground at the start, m."""
    pose: Mapping[str, float]
    """Default joint positions, rad, by regular expression over interface.JOINTS."""
    motors: Mapping[str, Motor]
    """Motors of the `hip`, `thigh` and `calf` joints."""
    foot_radius: float
    """Radius of the feet, m."""
    camera: MountCfg = field(default_factory=MountCfg)
    """Mount of the depth camera on the trunk."""
    stiffness: float = 40.0
    """Kp of every joint, N m/rad."""
    damping: float = 1.0
    """Kd of every joint, N m s/rad."""
    action_scale: float = 0.25
    """Change of a joint target per policy unit, rad."""
    map_height: float = MAP_HEIGHT
    """Height of the base above flat ground at which the height map is zero, m."""

    def entity(self) -> EntityCfg:
        """Build a new configuration for mjlab."""
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
        """Load the MJCF and check that it has all parts that tasks use.

        Raises:
            RenetError: A part is missing, which the message names.
        """
        if set(self.motors) != set(LEG_PARTS):
            expected = ", ".join(LEG_PARTS)
            raise RenetError(f"motors must be of {expected}, not {', '.join(self.motors)}")
        spec = self.spec()
        parts = (spec.body, BODIES), (spec.joint, JOINTS), (spec.geom, FEET), (spec.site, LEGS)
        for lookup, names in parts:
            for name in names:
                _part(lookup, name)
        demand_joints(spec)
        unlimited = [name for name in JOINTS if not _is_limited(spec.joint(name))]
        if unlimited:
            raise RenetError(
                f"the robot's MJCF gives {', '.join(unlimited)} no limits: set the joint's `range` "
                "in RobotCfg.spec, since position costs and bundles need it"
            )
        _check_calves(spec)
        # MuJoCo Warp accepts no margins between boxes, of which tiles consist.
        for geom in spec.geoms:
            geom.margin = 0.0
        return spec

    def motor(self, joint: str) -> Motor:
        """Return the motor of a joint of interface.JOINTS."""
        return self.motors[joint.split("_")[1]]

    def _servos(self) -> Iterator[BuiltinPositionActuatorCfg]:
        """Yield a group of servos for each kind of motor."""
        # A dictionary removes equal motors and keeps their order.
        for motor in dict.fromkeys(self.motors.values()):
            kinds = [kind for kind, other in self.motors.items() if other == motor]
            yield BuiltinPositionActuatorCfg(
                target_names_expr=(f".*_({'|'.join(kinds)})_joint",),
                stiffness=self.stiffness,
                damping=self.damping,
                effort_limit=motor.torque,
                armature=motor.armature,
            )


def _check_calves(spec: mujoco.MjSpec) -> None:
    """Raise RenetError unless all calves have equally many colliding geoms beside the foot."""
    counts = []
    for pattern in CALVES:
        names = [geom.name for geom in spec.geoms if re.fullmatch(pattern, geom.name)]
        counts.append(len(names))
    if 0 in counts or len(set(counts)) > 1:
        text = ", ".join(f"{leg} {count}" for leg, count in zip(LEGS, counts, strict=True))
        raise RenetError(
            f"calves must have equally many colliding geoms beside the foot, not none: {text}"
        )


def demand_joints(spec: mujoco.MjSpec) -> None:
    """Raise RenetError unless a robot has one free joint, of its trunk, and the joints JOINTS."""
    free = mujoco.mjtJoint.mjJNT_FREE
    bodies = [joint.parent.name for joint in spec.joints if joint.type == free]
    if bodies != [TRUNK]:
        where = ", ".join(bodies) or "none"
        raise RenetError(
            f"the robot's MJCF must have one free joint, on its body {TRUNK}, not on {where}: add "
            "<freejoint/> to that body, and remove others"
        )
    names = [joint.name or "one without a name" for joint in spec.joints if joint.type != free]
    others = [name for name in names if name not in JOINTS]
    if others:
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
    """Rename the parts of a vendor's MJCF as `RobotCfg.spec` needs them, in place.

    Args:
        spec: The robot alone, without ground.
        trunk: The vendor's name of the base body.
        feet: The vendor's names of the feet's geoms, by leg of interface.LEGS. The name of a body
            stands for its lowest colliding geom, because some of them have no name.
        bodies: The vendor's names of bodies FR_hip, FR_thigh, FR_calf, …, where they differ.
        joints: The vendor's names of the joints of interface.JOINTS, where they differ.

    Raises:
        RenetError: The MJCF lacks a part.
    """
    # Look all parts up before renaming any: a new name may be another part's old one.
    vendor_names = {TRUNK: trunk, **(bodies or {}), **(joints or {})}
    parts = {}
    for lookup, names in ((spec.body, BODIES), (spec.joint, JOINTS)):
        for name in names:
            parts[name] = _part(lookup, vendor_names.get(name, name))
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
        # A vendor's site of this name may be anywhere.
        site = spec.site(leg)
        if site is not None:
            spec.delete(site)
        geom.parent.add_site(name=leg, pos=geom.pos)
        geom.name = f"{leg}_foot_collision"
    for body in spec.bodies:
        geoms = [geom for geom in _colliding_geoms(body) if geom.name not in FEET]
        for number, geom in enumerate(geoms, start=1):
            geom.name = f"{body.name}_collision{number}"
    return spec


def _colliding_geoms(body: mujoco.MjsBody) -> list[mujoco.MjsGeom]:
    """List the geoms of a body that collide."""
    return [geom for geom in body.geoms if geom.contype or geom.conaffinity]


def _foot(spec: mujoco.MjSpec, name: str) -> mujoco.MjsGeom:
    """Find the geom of a foot, by its name or by that of a body, whose lowest geom it is."""
    body = spec.body(name)
    if spec.geom(name) is not None or body is None:
        return _part(spec.geom, name)
    geoms = _colliding_geoms(body)
    if not geoms:
        raise RenetError(f"the robot's MJCF has no geom that collides on the body {name!r}")
    return min(geoms, key=lambda geom: geom.pos[2])


def _is_limited(joint: mujoco.MjsJoint) -> bool:
    """Return True if a joint has limits; by default MuJoCo limits a joint that has a range."""
    low, high = joint.range
    if joint.limited == mujoco.mjtLimited.mjLIMITED_AUTO:
        return low < high
    return bool(joint.limited)


def _part(lookup: Callable, name: str):
    """Find a part of a spec by its name; raises RenetError if there is none."""
    part = lookup(name)
    if part is None:
        raise RenetError(f"the robot's MJCF has no {lookup.__name__} named {name!r}")
    return part
