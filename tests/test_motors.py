import json
import subprocess
import sys
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
        (lambda c: c.update(robot=3), "robot must be a name"),
        (lambda c: c.update(robot="Spot"), "are of a Spot, not of a Unitree Go2"),
        (lambda c: c.update(motors=[]), "must be an object"),
        (lambda c: c.update(evidence=3), "evidence must be an object"),
        (lambda c: c["motors"].pop("calf"), "no motor for FR_calf_joint: add 'calf'"),
        (lambda c: c["motors"].update(knee=c["motors"]["calf"]), "no joint 'knee'"),
        (lambda c: c["motors"]["hip"].pop("delay"), "'hip' must have armature, damping"),
        (lambda c: c["motors"].update(hip=None), "'hip' must have armature, damping"),
        (lambda c: c["motors"]["hip"].update(delay=-0.01), "delay of hip .* from 0 to 1, got -0.0"),
        (lambda c: c["motors"]["hip"].update(delay=float("nan")), "delay of hip .* got nan"),
        (lambda c: c["motors"]["hip"].update(delay=10**400), "delay of hip .* got 1000"),
        (lambda c: c["motors"]["hip"].update(armature="1"), "armature of hip must be a number"),
        (lambda c: c["motors"]["hip"].update(armature=True), "armature of hip must be a number"),
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


def test_no_pytorch():
    check = "import sys, renet.motors; sys.exit(bool({'torch', 'mujoco'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", check]).returncode == 0
