"""Sensors of all RENet tasks, and their names."""

from mjlab.envs import ManagerBasedRlEnvCfg
from mjlab.sensor import ContactMatch, ContactSensorCfg, SensorCfg

from renet.errors import RenetError
from renet.interface import FAR_MAP_X, FAR_MAP_Y, LEGS, TRUNK
from renet.robots import Robot
from renet.robots.model import CALVES, FEET
from renet.sim.depth.camera import DepthCameraCfg
from renet.sim.sensors import FeetHeightCfg, HeightMapCfg

DEPTH_CAMERA = "depth_camera"
HEIGHT_MAP = "height_map"
FAR_MAP = "far_map"
FEET_HEIGHT = "feet_height"
FEET_CONTACT = "feet_contact"
THIGH_TRUNK_CONTACT = "thigh_trunk_contact"
CALF_CONTACT = "calf_contact"


def sensors(robot: Robot) -> tuple[SensorCfg, ...]:
    """Configure contacts of feet, thighs, trunk and calves; camera; and heights of the terrain."""

    def contact(name: str, mode, pattern: tuple[str, ...], field: str) -> ContactSensorCfg:
        """Configure a sensor of contacts with the terrain."""
        return ContactSensorCfg(
            name=name,
            primary=ContactMatch(mode=mode, pattern=pattern, entity="robot"),
            secondary=ContactMatch(mode="subtree", pattern="terrain"),
            fields=(field,),
            reduce="netforce",
        )

    thighs = tuple(f"{leg}_thigh" for leg in LEGS)
    return (
        contact(FEET_CONTACT, "geom", FEET, "found"),
        contact(THIGH_TRUNK_CONTACT, "body", (*thighs, TRUNK), "force"),
        contact(CALF_CONTACT, "geom", CALVES, "force"),
        DepthCameraCfg(name=DEPTH_CAMERA, mount=robot.camera),
        HeightMapCfg(name=HEIGHT_MAP, base_height=robot.map_height),
        HeightMapCfg(name=FAR_MAP, x=FAR_MAP_X, y=FAR_MAP_Y, base_height=robot.map_height),
        FeetHeightCfg(name=FEET_HEIGHT, radius=robot.foot_radius),
    )


def depth_camera(cfg: ManagerBasedRlEnvCfg) -> DepthCameraCfg:
    """Find the depth camera's configuration in a task's; raises RenetError if there is none."""
    for sensor in cfg.scene.sensors:
        if isinstance(sensor, DepthCameraCfg):
            return sensor
    raise RenetError("the task has no depth camera: take one that is built like renet.tasks")
