"""When to trust vision: anomaly threshold, low-pass filter, monitors. NumPy only."""

from renet.selector.calibration import (
    MonitorCalibration,
    calibrate,
    calibrate_monitors,
    conformal_threshold,
)
from renet.selector.defaults import MONITORS, default_monitors
from renet.selector.filter import LowPassFilter, switch_delay
from renet.selector.guard import GuardCfg, GuardedSelector
from renet.selector.selector import Selector, SelectorCfg

__all__ = [
    "MONITORS",
    "GuardCfg",
    "GuardedSelector",
    "LowPassFilter",
    "MonitorCalibration",
    "Selector",
    "SelectorCfg",
    "calibrate",
    "calibrate_monitors",
    "conformal_threshold",
    "default_monitors",
    "switch_delay",
]
