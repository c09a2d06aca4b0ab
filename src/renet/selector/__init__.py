"""Decision when to trust vision: monitors, thresholds and a low-pass filter, in NumPy."""

from renet.selector.monitors import MONITORS, SelectorInput
from renet.selector.selector import SelectorSpec, make_selector

__all__ = ["MONITORS", "SelectorInput", "SelectorSpec", "make_selector"]
