"""Unitree Go1. Motors are those of mjlab's model, from the vendor's URDF."""

from pathlib import Path

from renet.robots.robot import Motor, Robot, register_robot

ROTOR_INERTIA = 0.000111842
"""Inertia of a motor's rotor, kg m^2."""
GEAR_RATIO = 6.0
"""Turns of the motor for one of a hip or thigh joint."""
CALF_GEAR_RATIO = 9.0
"""Turns of the motor for one of a calf joint."""

# Hips and thighs have the same motors.
_HIP = Motor(torque=23.7, velocity=30.1, armature=ROTOR_INERTIA * GEAR_RATIO**2)
_CALF = Motor(torque=35.55, velocity=20.06, armature=ROTOR_INERTIA * CALF_GEAR_RATIO**2)

GO1 = register_robot(
    Robot(
        name="Unitree Go1",
        mjcf=Path(__file__).with_name("go1.xml"),  # Written by tools/robot_models.py.
        height=0.278,
        pose={
            ".*thigh_joint": 0.9,
            ".*calf_joint": -1.8,
            ".*R_hip_joint": 0.1,
            ".*L_hip_joint": -0.1,
        },
        limits={
            ".*_hip_joint": (-0.863, 0.863),
            ".*_thigh_joint": (-0.686, 4.501),
            ".*_calf_joint": (-2.818, -0.888),
        },
        motors={"hip": _HIP, "thigh": _HIP, "calf": _CALF},
        foot_radius=0.023,
    )
)
"""The Go1. Gains and action scale are `Robot`'s defaults: Kp 40, Kd 1 and 0.25 rad."""
