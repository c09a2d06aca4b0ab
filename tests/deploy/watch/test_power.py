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


def test_a_hot_motor_is_told_although_the_battery_is_low():
    low = {"battery": 0.1}
    power = watched([low] * 3 + [low | {"temperature": 80.0}] * 3)
    battery, motor = power.warning.split("; ")
    assert battery == "the battery has less than 20% left"
    assert motor == "a motor has more than 65 °C"
    assert power.end == ""


def test_a_temperature_that_wavers_about_its_limit_is_told_once():
    power = PowerWatch(SafetyCfg())
    told = []
    for step in range(1000):
        temperature = 65.0 + (step // 10 % 2)
        power.look(state(time_of(step), temperature=temperature))
        if power.warning and told[-1:] != [power.warning]:
            told.append(power.warning)
        assert bool(power.warning) == bool(told)
    assert len(told) == 1
    for step in range(1000, 2000):
        power.look(state(time_of(step), temperature=50.0))
    assert power.warning == ""
