"""When to trust vision: anomaly threshold, low-pass filter, monitors. NumPy only."""

from renet.selector.monitors import MONITORS, SelectorInput
from renet.selector.selector import SelectorSpec, make_selector

__all__ = ["MONITORS", "SelectorInput", "SelectorSpec", "make_selector"]
