"""Unitree Go2."""

from pathlib import Path

from renet.camera import MountCfg
from renet.robots.robot import Motor, Robot, register_robot

GO2 = register_robot(
    Robot(
        name="Unitree Go2",
        mjcf=Path(__file__).with_name("go2.xml"),  # Written by tools/robot_models.py.
        height=0.30,
        pose={
            ".*_thigh_joint": 0.9,
            ".*_calf_joint": -1.8,
            ".*R_hip_joint": 0.1,
            ".*L_hip_joint": -0.1,
        },
        limits={
            ".*_hip_joint": (-1.0472, 1.0472),
            "F._thigh_joint": (-1.5708, 3.4907),
            "R._thigh_joint": (-0.5236, 4.5379),
            ".*_calf_joint": (-2.7227, -0.83776),
        },
        # Torques of the vendor's MJCF (MuJoCo Menagerie), velocities of its URDF. Armatures are
        # in the MJCF, as they were measured.
        motors={
            "hip": Motor(torque=23.7, velocity=30.1),
            "thigh": Motor(torque=23.7, velocity=30.1),
            "calf": Motor(torque=45.43, velocity=15.7),
        },
        foot_radius=0.022,
        # The mount of ZiwenZhuang/parkour (go2_distill_config.py): above the head, 23 degrees
        # down. Its own policies vary height by 3 cm, and turns by 0.1 rad.
        camera=MountCfg(
            position=(0.24, -0.0175, 0.12), pitch=0.40, position_error=0.03, angle_error=0.1
        ),
    )
)
"""The Go2. Gains are `Robot`'s defaults, Kp 40 and Kd 1, as in ZiwenZhuang/parkour."""
