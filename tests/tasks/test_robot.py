"""A robot's description with a mistake is refused in words that name it."""

import re
from collections.abc import Callable
from dataclasses import replace

import mujoco
import pytest

from renet.descriptions import find_description
from renet.errors import RenetError
from renet.interface import JOINTS, LEGS
from renet.tasks import make_env
from renet.tasks.config.go1 import GO1
from renet.tasks.config.go2 import GO2
from renet.tasks.parkour_env_cfg import flat_env_cfg, tile_env_cfg
from renet.tasks.robot_cfg import FEET, RobotCfg, rename_parts
from renet.tasks.terrains import tile_row


def edited(change: Callable[[mujoco.MjSpec], object]) -> RobotCfg:
    """A Go1 whose MJCF is changed."""

    def spec() -> mujoco.MjSpec:
        made = GO1.spec()
        change(made)
        return made

    return replace(GO1, spec=spec)


def without(*geoms: str) -> RobotCfg:
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
            edited(lambda s: [s.joint(f"{leg}_calf_joint").range.fill(0) for leg in ("FR", "RL")]),
            "gives FR_calf_joint, RL_calf_joint no limits",
        ),
        (
            edited(lambda s: s.delete(free_joint(s))),
            "one free joint, on its body trunk, not on none",
        ),
        (
            edited(wheels),
            "other joints than the 12 of its legs: FR_wheel_joint, one without a name",
        ),
        (replace(GO1, motors={"hip": GO1.motors["hip"]}), "motors must be of hip, thigh, calf"),
    ],
)
def test_what_is_missing_is_named(robot, problem):
    with pytest.raises(RenetError, match=problem):
        make_env(flat_env_cfg(robot=robot), 1)


@pytest.mark.parametrize("robot", [GO1, GO2], ids=["go1", "go2"])
def test_feet_hold_the_robot_above_the_ground(robot):
    spec = mujoco.MjSpec.from_file(str(find_description(robot.name).mjcf))
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[5, 5, 1], contype=1)
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[2] = robot.height
    for joint in JOINTS:
        (pose,) = (angle for name, angle in robot.pose.items() if re.fullmatch(name, joint))
        data.joint(joint).qpos = data.actuator(joint).ctrl = pose
    mujoco.mj_step(model, data, 600)
    assert sorted({model.geom(pair[1]).name for pair in data.contact.geom}) == sorted(FEET)
    assert data.contact.dist.min() > -0.003
    assert all(data.geom(foot).xpos[2] > robot.foot_radius - 0.003 for foot in FEET)


def test_margins_of_a_vendors_geoms_are_dropped():
    robot = edited(lambda spec: [setattr(geom, "margin", 0.001) for geom in spec.geoms])
    assert not robot.checked_spec().compile().geom_margin.any()
    # Which MuJoCo Warp would have refused on boxes.
    make_env(tile_env_cfg(tile_row({"gap": 1}), robot=robot), 1).close()


def test_vendor_sites_are_replaced():
    made, feet = GO1.spec(), {leg: f"{leg}_foot_collision" for leg in LEGS}
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
        rename_parts(GO1.spec(), trunk="trunk", feet={})


def test_unnamed_foot_is_lowest_geom():
    made = GO1.spec()
    for leg in LEGS:
        made.geom(f"{leg}_foot_collision").name = ""
    renamed = rename_parts(made, trunk="trunk", feet={leg: f"{leg}_calf" for leg in LEGS})
    for leg in LEGS:
        expected = GO1.spec().geom(f"{leg}_foot_collision").pos
        assert (renamed.geom(f"{leg}_foot_collision").pos == expected).all()
    renamed.compile()
