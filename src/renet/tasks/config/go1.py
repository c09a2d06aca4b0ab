"""Unitree Go1 as RENet drives it: mjlab's asset with soft joint servos."""

from mjlab.asset_zoo.robots.unitree_go1 import go1_constants as go1
from mjlab.utils.actuator import ElectricActuator

from renet.tasks.robot_cfg import Motor, RobotCfg


def _motor(actuator: ElectricActuator) -> Motor:
    return Motor(actuator.effort_limit, actuator.velocity_limit, actuator.reflected_inertia)


GO1 = RobotCfg(
    name="Unitree Go1",
    spec=go1.get_spec,
    height=go1.INIT_STATE.pos[2],
    pose=go1.INIT_STATE.joint_pos or {},
    motors={
        "hip": _motor(go1.HIP_ACTUATOR),
        "thigh": _motor(go1.HIP_ACTUATOR),
        "calf": _motor(go1.KNEE_ACTUATOR),
    },
    foot_radius=0.023,
)
"""Servos' gains and the size of actions are RobotCfg's defaults, Kp 40, Kd 1 and 0.25 rad."""
