"""Unitree Go2 as RENet drives it: the model that ships with renet, with soft joint servos."""

import mujoco

from renet.descriptions import GO2 as DESCRIPTION
from renet.sim.depth.camera import MountCfg
from renet.tasks.robot_cfg import Motor, RobotCfg


def spec() -> mujoco.MjSpec:
    """Load the MJCF without servos, which mjlab adds, and physics options, which the task sets."""
    spec = mujoco.MjSpec.from_file(str(DESCRIPTION.mjcf))
    spec.option = mujoco.MjSpec().option
    for servo in list(spec.actuators):
        spec.delete(servo)
    return spec


GO2 = RobotCfg(
    name=DESCRIPTION.name,
    spec=spec,
    height=DESCRIPTION.height,
    pose={
        ".*_thigh_joint": 0.9,
        ".*_calf_joint": -1.8,
        ".*R_hip_joint": 0.1,
        ".*L_hip_joint": -0.1,
    },
    # Torques of the vendor's MJCF (MuJoCo Menagerie), speeds of its URDF.
    motors={
        "hip": Motor(torque=23.7, velocity=DESCRIPTION.speeds["hip"]),
        "thigh": Motor(torque=23.7, velocity=DESCRIPTION.speeds["thigh"]),
        "calf": Motor(torque=45.43, velocity=DESCRIPTION.speeds["calf"]),
    },
    foot_radius=0.022,
    # The mount of ZiwenZhuang/parkour (go2_distill_config.py): above the head, 23 degrees down. Its
    # own policies vary height by 3 cm, and turns by 0.1 rad.
    camera=MountCfg(
        position=(0.24, -0.0175, 0.12), pitch=0.40, position_error=0.03, angle_error=0.1
    ),
)
"""The Go2. Gains are RobotCfg's defaults, Kp 40 and Kd 1, as in ZiwenZhuang/parkour."""
