"""Unitree Go1 as RENet drives it: mjlab's asset with soft joint servos."""

from mjlab.asset_zoo.robots.unitree_go1 import go1_constants as go1

from renet.tasks.robot_cfg import Motor, RobotCfg

# The Go1 has the same motors in hips and thighs.
_ACTUATORS = {"hip": go1.HIP_ACTUATOR, "thigh": go1.HIP_ACTUATOR, "calf": go1.KNEE_ACTUATOR}
GO1 = RobotCfg(
    name="Unitree Go1",
    spec=go1.get_spec,
    height=go1.INIT_STATE.pos[2],
    pose=go1.INIT_STATE.joint_pos or {},
    motors={
        part: Motor(motor.effort_limit, motor.velocity_limit, motor.reflected_inertia)
        for part, motor in _ACTUATORS.items()
    },
    foot_radius=0.023,
)
"""The Go1. Gains and action scale are RobotCfg's defaults: Kp 40, Kd 1 and 0.25 rad."""
