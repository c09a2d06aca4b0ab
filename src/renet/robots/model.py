"""Models of robots in MuJoCo: as tasks train them, and as the runtime simulates them."""

import re
from collections.abc import Callable, Mapping

import mujoco
import numpy as np

from renet.errors import RenetError
from renet.interface import JOINTS, LEGS, PHYSICS_DT, TRUNK
from renet.motors import KINDS
from renet.robots.robot import Robot

BODIES = (TRUNK, *(f"{leg}_{kind}" for leg in LEGS for kind in KINDS))
"""Names of all bodies that tasks use."""
FEET = tuple(f"{leg}_foot_collision" for leg in LEGS)
"""Names of the feet's geoms. A site at the centre of each foot has the name of its leg."""
CALVES = tuple(rf"{leg}_calf_collision\d*" for leg in LEGS)
"""Patterns of the calves' other colliding geoms."""
BASE_JOINT = "floating_base_joint"
"""Name of the trunk's free joint, where a model gives it none."""
COLLISION = re.compile(r".*_collision\d*")
"""Pattern of all colliding geoms."""
COLLISION_GROUP = 3
"""MuJoCo group of a simulated robot's geoms, which the rays of simulated cameras pass through."""
ITERATIONS = 20
"""Most iterations of MuJoCo's solver, in training and in the runtime, so that policies transfer."""
LS_ITERATIONS = 20
"""Most iterations of its line search."""
CCD_ITERATIONS = 50
"""Most iterations of its collision detection between convex geoms."""


def load_robot_model(robot: Robot) -> mujoco.MjSpec:
    """Load a robot's model without servos, with the joint limits and armatures of its description.

    Names are renet's (see `rename_parts`): bodies `trunk`, `FR_hip`, `FR_thigh`, `FR_calf`, …; the
    joints of `interface.JOINTS` in any order; colliding geoms `*_collision*`; feet
    `FR_foot_collision`, …, with a site `FR`, … at the centre of each. All calves have the same
    number of colliding geoms, at least one beside the foot.

    Raises:
        RenetError: A part is missing, which the message names.
    """
    spec = mujoco.MjSpec.from_file(str(robot.mjcf)) if robot.spec is None else robot.spec()
    _check_parts(spec)
    base = spec.body(TRUNK).first_joint()
    base.name = base.name or BASE_JOINT
    # Physics options are the task's, and servos are mjlab's in training.
    spec.option = mujoco.MjSpec().option
    for servo in list(spec.actuators):
        spec.delete(servo)
    for name, lower, upper in zip(JOINTS, robot.lower, robot.upper, strict=True):
        joint = spec.joint(name)
        joint.range = (lower, upper)
        armature = robot.motor(name).armature
        if armature is not None:
            joint.armature = armature
    _set_contacts(spec)
    return spec


def simulation_model(robot: Robot) -> mujoco.MjSpec:
    """Load a robot's model with ideal servos and physics options, and without visual meshes."""
    spec = load_robot_model(robot)
    # What remains is what touches the ground, and what the viewer shows.
    for geom in list(spec.geoms):
        if not geom.contype and not geom.conaffinity:
            spec.delete(geom)
        else:
            geom.group = COLLISION_GROUP
            geom.material = ""
    looks = (spec.meshes, spec.materials, spec.textures, spec.cameras)
    for group in (*looks, spec.keys, spec.sensors):
        for item in list(group):
            spec.delete(item)
    spec.meshdir = ""
    option = spec.option
    option.timestep = PHYSICS_DT
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL
    option.iterations = ITERATIONS
    option.ls_iterations = LS_ITERATIONS
    option.ccd_iterations = CCD_ITERATIONS
    for joint in JOINTS:
        _add_servo(spec, joint, robot)
    return spec


def _add_servo(spec: mujoco.MjSpec, joint: str, robot: Robot) -> None:
    """Add a servo, named as its joint: torque = Kp (target - q) - Kd dq/dt, within the motor's."""
    servo = spec.add_actuator(name=joint, target=joint)
    servo.trntype = mujoco.mjtTrn.mjTRN_JOINT
    servo.gaintype = mujoco.mjtGain.mjGAIN_FIXED
    servo.biastype = mujoco.mjtBias.mjBIAS_AFFINE
    servo.gainprm[0] = robot.stiffness
    servo.biasprm[1] = -robot.stiffness
    servo.biasprm[2] = -robot.damping
    # Targets may be beyond the joint's limits, where a servo pushes against its end stop.
    servo.ctrllimited = False
    servo.forcelimited = True
    torque = robot.motor(joint).torque
    servo.forcerange = (-torque, torque)


def _set_contacts(spec: mujoco.MjSpec) -> None:
    """Let the colliding geoms touch the terrain (contype 1) but not each other.

    Self-collision takes a third of the time of the physics, and a policy inside its joint limits
    does not need it.
    """
    for geom in spec.geoms:
        # MuJoCo Warp accepts no margins between boxes, of which tiles consist.
        geom.margin = 0.0
        geom.contype = 0
        geom.conaffinity = 0
        if not COLLISION.fullmatch(geom.name):
            continue
        geom.conaffinity = 1
        is_foot = geom.name in FEET
        geom.condim = 3 if is_foot else 1
        geom.priority = 1 if is_foot else 0
        if is_foot:
            geom.friction[0] = 1.0


def _check_parts(spec: mujoco.MjSpec) -> None:
    """Raise RenetError unless a model has all parts that tasks use, and no others that move."""
    parts = (spec.body, BODIES), (spec.joint, JOINTS), (spec.geom, FEET), (spec.site, LEGS)
    for lookup, names in parts:
        for name in names:
            _part(lookup, name)
    demand_joints(spec)
    _check_calves(spec)


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


def joint_addresses(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Return where a state holds the joints of `interface.JOINTS`: indices of qpos and of qvel."""
    joints = [model.joint(name) for name in JOINTS]
    qpos = np.array([joint.qposadr[0] for joint in joints])
    qvel = np.array([joint.dofadr[0] for joint in joints])
    return qpos, qvel


def trunk_addresses(model: mujoco.MjModel) -> tuple[slice, slice]:
    """Return where a state holds a free trunk: 7 numbers of qpos, and 6 of qvel."""
    joint = model.body(TRUNK).jntadr[0]
    qpos = model.jnt_qposadr[joint]
    qvel = model.jnt_dofadr[joint]
    return slice(qpos, qpos + 7), slice(qvel, qvel + 6)


def servo_ids(model: mujoco.MjModel) -> np.ndarray:
    """Return the ids of the servos of `interface.JOINTS`, whose names they have, [12]."""
    return np.array([model.actuator(name).id for name in JOINTS])


def rename_parts(
    spec: mujoco.MjSpec,
    trunk: str,
    feet: Mapping[str, str],
    bodies: Mapping[str, str] | None = None,
    joints: Mapping[str, str] | None = None,
) -> mujoco.MjSpec:
    """Rename the parts of a vendor's MJCF as `load_robot_model` needs them, in place.

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


def _part(lookup: Callable, name: str):
    """Find a part of a spec by its name; raises RenetError if there is none."""
    part = lookup(name)
    if part is None:
        raise RenetError(f"the robot's MJCF has no {lookup.__name__} named {name!r}")
    return part
