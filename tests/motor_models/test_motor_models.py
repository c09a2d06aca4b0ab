"""What `--motors` takes, and refuses."""

import pytest

from renet.errors import RenetError
from renet.motor_models import find_motors, motors_key
from renet.motor_models.network import MotorNetwork
from renet.motors import MotorFit, MotorParameters, write_motors


@pytest.fixture
def fit() -> MotorFit:
    motor = MotorParameters(armature=0.01, damping=0.2, friction=0.3, delay=0.01)
    return MotorFit("Unitree Go2", dict.fromkeys(("hip", "thigh", "calf"), motor))


def test_motors_are_found_by_name_or_file(tmp_path, fit):
    path = tmp_path / "motors.json"
    write_motors(path, fit)
    assert find_motors("ideal", "Unitree Go1") is None
    assert isinstance(find_motors("go1", "Unitree Go1"), MotorNetwork)
    assert find_motors(str(path), "Unitree Go2") == fit


def test_motors_of_another_robot_are_refused(tmp_path, fit):
    path = tmp_path / "motors.json"
    write_motors(path, fit)
    with pytest.raises(RenetError, match="a Unitree Go1's, and this robot is a Unitree Go2"):
        find_motors("go1", "Unitree Go2")
    with pytest.raises(RenetError, match="not of a Unitree Go1"):
        find_motors(str(path), "Unitree Go1")


@pytest.mark.parametrize("find", [lambda name: find_motors(name, "Unitree Go1"), motors_key])
def test_unknown_motors_are_refused(find):
    with pytest.raises(RenetError, match="must be ideal, go1 or a file"):
        find("go3")


def test_the_key_changes_with_a_files_content_not_its_name(tmp_path, fit):
    first, second = tmp_path / "a.json", tmp_path / "b.json"
    write_motors(first, fit)
    write_motors(second, fit)
    key = motors_key(str(first))
    assert motors_key(str(second)) == key
    second.write_text(second.read_text().replace("0.01", "0.02"))
    assert motors_key(str(second)) != key
    assert motors_key("go1") != motors_key("ideal")
