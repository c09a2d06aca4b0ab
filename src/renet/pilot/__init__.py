"""The pilot: observation and depth image in, joint targets out, whatever the camera does."""

from renet.pilot.images import Images
from renet.pilot.pilot import PILOT_MODES, Pilot, Step

__all__ = ["PILOT_MODES", "Images", "Pilot", "Step"]
