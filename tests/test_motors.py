import json
from dataclasses import replace

import numpy as np
import pytest

from renet.errors import RenetError
from renet.interface import JOINTS
from renet.motors import KINDS, MotorFit, MotorParameters, joint_kind, read_motors, write_motors

HIP = MotorParameters(armature=0.01, damping=0.2, friction=0.3, delay=0.004)
MOTORS = {"hip": HIP, "thigh": replace(HIP, armature=0.02), "calf": replace(HIP, friction=0.9)}


def test_round_trip(tmp_path):
    fit = MotorFit("Unitree Go2", MOTORS, {"rmse": 0.02})
    write_motors(tmp_path / "motors.json", fit)
    assert read_motors(tmp_path / "motors.json", "Unitree Go2") == fit


def test_joint_before_kind():
    fit = MotorFit("Unitree Go2", MOTORS | {"RL_calf_joint": replace(HIP, friction=2.0)})
    assert fit.of("RL_calf_joint").friction == 2.0
    assert fit.of("RR_calf_joint").friction == 0.9
    expected = [{"hip": 0.3, "thigh": 0.3, "calf": 0.9}[joint_kind(joint)] for joint in JOINTS]
    expected[JOINTS.index("RL_calf_joint")] = 2.0
    np.testing.assert_array_equal(fit.array("friction"), expected)


def test_every_joint_has_a_kind():
    assert {joint_kind(joint) for joint in JOINTS} == set(KINDS)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c.update(format="other"), "not a file of `renet identify`"),
        (lambda c: c.update(schema=9), "schema 9; this renet reads 1"),
        (
            lambda c: c.update(robot=3),
            "motors.json: robot: Expected `str`, got `int`; mend",
        ),
        (lambda c: c.update(robot="Spot"), "are of a Spot, not of a Unitree Go2"),
        (lambda c: c.update(motors=[]), "Expected `object`, got `array`"),
        (lambda c: c.update(evidence=3), "evidence must be an object"),
        (lambda c: c["motors"].pop("calf"), "no motor for FR_calf_joint: add 'calf'"),
        (lambda c: c["motors"].update(knee=c["motors"]["calf"]), "no joint 'knee'"),
        (lambda c: c["motors"]["hip"].pop("delay"), "hip.*missing required field `delay`"),
        (lambda c: c["motors"]["hip"].update(mass=1.0), "hip.*there is no field 'mass'"),
        (lambda c: c["motors"].update(hip=None), "'hip' of .*Expected `object`, got `null`"),
        (lambda c: c["motors"]["hip"].update(delay=-0.01), "delay of hip .* from 0 to 1, got -0.0"),
        (lambda c: c["motors"]["hip"].update(delay=float("nan")), "delay must be a finite number"),
        (lambda c: c["motors"]["hip"].update(delay=10**400), "delay: Number out of range"),
        (lambda c: c["motors"]["hip"].update(armature="1"), "hip.*armature: Expected `float`"),
        (lambda c: c["motors"]["hip"].update(armature=True), "hip.*armature: Expected `float`"),
    ],
)
def test_bad_file(tmp_path, change, message):
    path = tmp_path / "motors.json"
    write_motors(path, MotorFit("Unitree Go2", MOTORS))
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))
    with pytest.raises(RenetError, match=message) as error:
        read_motors(path, "Unitree Go2")
    assert "\n" not in str(error.value)
