"""A flight made by hand, whose falls, metres and delays are known."""

import numpy as np
import pytest

from renet.deploy.controller import Event
from renet.deploy.recording.reader import Recording
from renet.deploy.recording.tick import GOOD, MODES, TICK_DTYPE
from renet.deploy.safety.machine import Mode
from renet.interface import CONTROL_DT

from ..fakes import turned

STEPS, RISEN, BLIND = 500, 100, 300


@pytest.fixture
def flight() -> Recording:
    """2 s of rising, then walking at 0.5 m/s to the left of the start; OP from 6 s on."""
    ticks = np.zeros(STEPS, TICK_DTYPE)
    ticks["now"] = 1000.0 + CONTROL_DT * np.arange(STEPS)
    ticks["state"], ticks["quaternion"] = GOOD, turned("z", 90)
    ticks["mode"] = MODES.index(Mode.WALKING)
    ticks["mode"][:RISEN] = MODES.index(Mode.STANDING_UP)
    ticks["vision"][RISEN:BLIND] = True
    ticks["has_image"][: BLIND - 20] = True
    ticks["told"][:, 0] = 0.6
    ticks["velocity_op"][:, 0], ticks["velocity_vp"][:, 0] = 0.4, 0.5
    ticks["base_position"] = np.nan
    ticks["compute_ms"] = 1.0
    ticks["compute_ms"][7] = 9.0
    ticks["anomaly"] = 0.01
    ticks["anomaly"][:RISEN] = np.inf
    events = [Event(1002.0, "walking", "stood_up"), Event(1006.0, "blind", "no <new> image")]
    return Recording(
        {"thresholds": {"reconstruction": 0.02}, "fault": ["unplugged@5.8s"]},
        ticks,
        {},
        events,
        True,
    )
