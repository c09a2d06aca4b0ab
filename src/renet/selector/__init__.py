"""When to trust vision: anomaly threshold, low-pass filter, monitors. NumPy only."""

from renet.selector.calibration import (
    MonitorCalibration,
    calibrate,
    calibrate_monitors,
    conformal_threshold,
)
from renet.selector.filter import LowPassFilter, switch_delay
from renet.selector.monitors import MONITORS, SelectorInput, default_monitors
from renet.selector.selector import (
    SELECTORS,
    MonitorSelector,
    SelectorCfg,
    SelectorSpec,
    check_kind,
    check_selector,
    make_selector,
)

__all__ = [
    "MONITORS",
    "SELECTORS",
    "LowPassFilter",
    "MonitorCalibration",
    "MonitorSelector",
    "SelectorCfg",
    "SelectorInput",
    "SelectorSpec",
    "calibrate",
    "calibrate_monitors",
    "check_kind",
    "check_selector",
    "conformal_threshold",
    "default_monitors",
    "make_selector",
    "switch_delay",
]
