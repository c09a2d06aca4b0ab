"""The pilot: observation and depth image in, joint targets out, whatever the camera does."""

from renet.pilot.images import Images
from renet.pilot.pilot import MODES, Pilot, Step

__all__ = ["MODES", "Images", "Pilot", "Step"]
