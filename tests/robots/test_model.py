"""Models of robots as tasks train them, and mistakes in them."""

from collections.abc import Callable
from dataclasses import replace

import mujoco
import pytest

from renet.errors import RenetError
from renet.interface import JOINTS, LEGS
from renet.motors import KINDS
from renet.robots import GO1, GO2, Robot
from renet.robots.model import FEET, load_robot_model, rename_parts, simulation_model
from renet.tasks import VISUAL_GO1, make_env
from renet.tasks.parkour_env_cfg import flat_env_cfg, tile_env_cfg
from renet.tasks.terrains import tile_row


def edited(change: Callable[[mujoco.MjSpec], object]) -> Robot:
    """A Go1 whose MJCF is changed."""

    def spec() -> mujoco.MjSpec:
        made = VISUAL_GO1.spec()
        change(made)
        return made

    return replace(VISUAL_GO1, spec=spec)


def without(*geoms: str) -> Robot:
    return edited(lambda spec: [spec.delete(spec.geom(name)) for name in geoms])


def free_joint(spec: mujoco.MjSpec) -> mujoco.MjsJoint:
    (free,) = (joint for joint in spec.joints if joint.type == mujoco.mjtJoint.mjJNT_FREE)
    return free


def wheels(spec: mujoco.MjSpec) -> None:
    """Two wheels, as a Go2-W has them."""
    for leg, name in (("FR", "FR_wheel_joint"), ("FL", "")):
        wheel = spec.body(f"{leg}_calf").add_body(pos=(0.0, 0.0, -0.2))
        wheel.add_joint(name=name, axis=(0.0, 1.0, 0.0))
        wheel.add_geom(size=(0.05, 0.0, 0.0))


@pytest.mark.parametrize(
    ("robot", "problem"),
    [
        (without("RL_foot_collision"), "no geom named 'RL_foot_collision'"),
        (edited(lambda spec: spec.delete(spec.site("FL"))), "no site named 'FL'"),
        (without("FR_calf_collision2"), "beside the foot, not none: FR 1, FL 2, RR 2, RL 2"),
        (without("RR_calf_collision1", "RR_calf_collision2"), "RR 0"),
        (
            edited(lambda s: s.delete(free_joint(s))),
            "one free joint, on its body trunk, not on none",
        ),
        (
            edited(wheels),
            "other joints than the 12 of its legs: FR_wheel_joint, one without a name",
        ),
    ],
)
def test_what_is_missing_is_named(robot, problem):
    with pytest.raises(RenetError, match=problem):
        make_env(flat_env_cfg(robot=robot), 1)


@pytest.mark.parametrize("robot", [GO1, VISUAL_GO1, GO2], ids=["go1", "visual go1", "go2"])
def test_feet_hold_the_robot_above_the_ground(robot):
    spec = simulation_model(robot)
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[5, 5, 1], contype=1)
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[2] = robot.height
    for joint, angle in zip(JOINTS, robot.default_position, strict=True):
        data.joint(joint).qpos = angle
        data.actuator(joint).ctrl = angle
    mujoco.mj_step(model, data, 600)
    assert sorted({model.geom(pair[1]).name for pair in data.contact.geom}) == sorted(FEET)
    assert data.contact.dist.min() > -0.003
    assert all(data.geom(foot).xpos[2] > robot.foot_radius - 0.003 for foot in FEET)


def test_margins_of_a_vendors_geoms_are_dropped():
    robot = edited(lambda spec: [setattr(geom, "margin", 0.001) for geom in spec.geoms])
    assert not load_robot_model(robot).compile().geom_margin.any()
    # Which MuJoCo Warp would have refused on boxes.
    make_env(tile_env_cfg(tile_row({"gap": 1}), robot=robot), 1).close()


def test_vendor_sites_are_replaced():
    made, feet = VISUAL_GO1.spec(), {leg: f"{leg}_foot_collision" for leg in LEGS}
    made.delete(made.site("FL"))
    made.body("trunk").add_site(name="FL", pos=(0.0, 0.0, 0.3))
    kind, site = mujoco.mjtSensor.mjSENS_FRAMEPOS, mujoco.mjtObj.mjOBJ_SITE
    made.add_sensor(name="height", type=kind, objname="FL", objtype=site)
    renamed = rename_parts(made, trunk="trunk", feet=feet)
    for leg in LEGS:
        assert renamed.site(leg).parent.name == f"{leg}_calf"
        assert (renamed.site(leg).pos == renamed.geom(f"{leg}_foot_collision").pos).all()
    renamed.compile()


def test_all_feet_must_be_named():
    with pytest.raises(RenetError, match="feet must be of FR, FL, RR, RL, not none"):
        rename_parts(VISUAL_GO1.spec(), trunk="trunk", feet={})


def test_unnamed_foot_is_lowest_geom():
    made = VISUAL_GO1.spec()
    for leg in LEGS:
        made.geom(f"{leg}_foot_collision").name = ""
    renamed = rename_parts(made, trunk="trunk", feet={leg: f"{leg}_calf" for leg in LEGS})
    for leg in LEGS:
        expected = VISUAL_GO1.spec().geom(f"{leg}_foot_collision").pos
        assert (renamed.geom(f"{leg}_foot_collision").pos == expected).all()
    renamed.compile()


def test_limits_and_armatures_are_the_descriptions():
    motors = {kind: replace(motor, armature=0.5) for kind, motor in GO2.motors.items()}
    limits = {".*_hip_joint": (-0.5, 0.6), ".*_thigh_joint": (0.0, 2.0), ".*_calf_joint": (-2, -1)}
    for load in (load_robot_model, simulation_model):
        model = load(replace(GO2, motors=motors, limits=limits)).compile()
        assert [tuple(model.joint(f"RL_{kind}_joint").range) for kind in KINDS] == [
            *limits.values()
        ]
        assert all(model.joint(joint).armature == 0.5 for joint in JOINTS)


def test_servos_saturate_at_the_motors_torque():
    model = simulation_model(replace(GO1, stiffness=30.0, damping=2.0)).compile()
    data = mujoco.MjData(model)
    knee = model.actuator("FL_calf_joint").id
    data.joint("FL_calf_joint").qpos[0] = -1.8
    data.joint("FL_calf_joint").qvel[0] = 0.5
    for target, torque in ((-1.7, 30.0 * 0.1 - 2.0 * 0.5), (5.0, 35.55), (-9.0, -35.55)):
        data.ctrl[knee] = target
        mujoco.mj_forward(model, data)
        assert data.actuator_force[knee] == pytest.approx(torque)


def test_simulated_robots_are_seen_by_no_camera_and_need_no_meshes():
    model = simulation_model(VISUAL_GO1).compile()
    assert model.nmesh == 0
    assert set(model.geom_group.tolist()) == {3}
    assert model.ngeom == simulation_model(GO1).compile().ngeom
