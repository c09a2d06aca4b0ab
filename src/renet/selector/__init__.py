"""When to trust vision: anomaly threshold, low-pass filter, monitors. NumPy only."""

from renet.selector.calibration import calibrate, conformal_threshold
from renet.selector.filter import LowPassFilter, switch_delay
from renet.selector.guard import GuardCfg, GuardedSelector
from renet.selector.selector import Selector, SelectorCfg

__all__ = [
    "GuardCfg",
    "GuardedSelector",
    "LowPassFilter",
    "Selector",
    "SelectorCfg",
    "calibrate",
    "conformal_threshold",
    "switch_delay",
]
