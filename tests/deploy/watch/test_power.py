"""Battery, motors and the robot's own word, three readings in a row."""

import math

import pytest

from renet.deploy.safety.limits import SafetyCfg
from renet.deploy.watch.power import PowerWatch

from ..fakes import state, time_of


def watched(changes) -> PowerWatch:
    power = PowerWatch(SafetyCfg())
    for step, change in enumerate(changes):
        power.look(state(time_of(step), **change))
        power.look(state(time_of(step), **change))  # The same one again.
    return power


@pytest.mark.parametrize(
    ("change", "warning", "end"),
    [
        ({"temperature": 200.0}, "a motor has more than 65 °C", "a motor has more than 85 °C"),
        ({"temperature": 70.0}, "a motor has more than 65 °C", ""),
        ({"battery": 0.03}, "the battery has less than 20% left", "the battery has less than 5%"),
        ({"fault": "the motor of FR_hip_joint has left its mode"}, "", "the motor of FR_hip_joint"),
        ({"battery": math.nan, "temperature": math.nan}, "", ""),
        ({"battery": None}, "", ""),
    ],
)
def test_three_readings_in_a_row_end_a_walk_and_two_do_not(change, warning, end):
    three, fine = watched([change] * 3), {"battery": 0.8, "temperature": 40.0}
    assert three.warning == warning
    assert three.end.startswith(end)
    assert bool(three.end) == bool(end)
    for few in (watched([change] * 2), watched([change] * 2 + [fine] + [change] * 2)):
        assert (few.warning, few.end) == ("", "")
