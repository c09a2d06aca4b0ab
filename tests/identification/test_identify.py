import json
import sys
from hashlib import sha256

import numpy as np
import pytest

from renet.cli import main
from renet.deploy.recording.channels import Topic
from renet.deploy.recording.tick import GOOD, TICK_DTYPE
from renet.errors import RenetError
from renet.identification.identify import IdentifyCfg, look_up_robot, root_mean_squares
from renet.interface import JOINTS
from renet.motors import PARAMETERS, read_motors
from renet.robots import robot

from ..hostile.files import messages, recording
from .conftest import MOTORS, named, write_csv

CLOSE = {"armature": 0.002, "damping": 0.03, "friction": 0.03, "delay": 0.001}
"""By how much motors that were fitted may differ from those of the simulation."""


@pytest.fixture(scope="module")
def fitted(motion, tmp_path_factory):
    folder = tmp_path_factory.mktemp("identify")
    log = write_csv(folder / "log.csv", named(motion))
    out = folder / "motors" / "go2.json"
    assert main(["identify", str(log), "--robot", "go2", "--out", str(out)]) == 0
    return log, out


def test_known_motors_are_recovered(fitted):
    fit = read_motors(fitted[1], "Unitree Go2")
    for kind, motor in MOTORS.items():
        for parameter in PARAMETERS:
            found = getattr(fit.motors[kind], parameter)
            assert found == pytest.approx(motor[parameter], abs=CLOSE[parameter]), (kind, parameter)


def test_evidence(fitted):
    log, out = fitted
    evidence = json.loads(out.read_text())["evidence"]
    assert evidence["log"]["sha256"] == sha256(log.read_bytes()).hexdigest()
    assert evidence["command"]
    rmse = evidence["rmse_rad"]
    assert rmse["fitted"]["seconds"] == [0.0, 4.0]
    assert rmse["held_out"]["seconds"] == [4.0, 8.0]
    assert rmse["held_out"]["measured"]["all"] < 0.1 * rmse["held_out"]["described"]["all"]
    errors = [value for row in evidence["standard_error"].values() for value in row.values()]
    assert len(errors) == 12
    assert all(0.0 < error < 0.1 for error in errors)


def test_errors_by_kind_and_within_limits():
    errors = np.tile([1.0, 2.0, 3.0], (200, 4))
    weight = np.tile([True, False, False], (200, 4))
    expected = {"all": 2.16025, "within_limits": 1.0, "hip": 1.0, "thigh": 2.0, "calf": 3.0}
    assert root_mean_squares(errors, weight, 0.005) == expected


def test_progress(motion, tmp_path, capsys):
    log = write_csv(tmp_path / "log.csv", named(motion, 900))
    arguments = ["--robot", "go2", "--out", str(tmp_path / "motors.json"), "--timestep", "0.005"]
    assert main(["identify", str(log), *arguments]) == 0
    out, err = capsys.readouterr()
    assert "iteration 1: RMSE 0." in err
    assert "RMSE of what was held out: 0." in out
    assert f"Results: {tmp_path / 'motors.json'}" in out


def degrees(columns):
    for name in columns:
        if name.startswith(JOINTS):
            columns[name] = np.degrees(columns[name])


def still(columns):
    columns["FL_calf_joint_position"] = np.full(len(columns["time"]), -1.5)


def beyond(columns):
    columns["RR_hip_joint_target"] = np.full(len(columns["time"]), 2.0)


def shorten(columns):
    for name in columns:
        columns[name] = columns[name][:700]


@pytest.mark.parametrize(
    ("change", "arguments", "message"),
    [
        (degrees, [], "are the log's angles in rad"),
        (still, [], "FL_calf_joint moves by 0.000 rad only"),
        (beyond, [], "every target of RR_hip_joint is beyond its limits"),
        (shorten, [], "has 3.5 s, of which 1.8 s are to be fitted or held out: at least 2 s"),
        (dict, ["--fit-share", "0.2"], "of which 1.6 s are to be fitted"),
        (dict, ["--robot", "spot"], "unknown robot 'spot'"),
        (dict, ["--fit-share", "1.5"], "--fit-share must be from 0.1 to 0.9, got 1.5"),
        (dict, ["--timestep", "0.1"], "--timestep must be from 0.0001 to 0.01 s, got 0.1"),
        (dict, ["--out", "."], "it is a folder"),
        (dict, ["--out", "log.csv/motors.json"], "nothing can be written to"),
    ],
)
def test_mistakes(motion, tmp_path, monkeypatch, capsys, change, arguments, message):
    monkeypatch.chdir(tmp_path)
    columns = named(motion)
    change(columns)
    write_csv(tmp_path / "log.csv", columns)
    robot = [] if "--robot" in arguments else ["--robot", "go2"]
    assert main(["identify", "log.csv", *robot, *arguments]) == 2
    out, err = capsys.readouterr()
    assert message in err, err
    assert err.startswith("renet: ")
    assert err.count("\n") == 1, err
    assert not out
    assert [path.name for path in tmp_path.iterdir()] == ["log.csv"]


def test_without_scipy(monkeypatch, capsys, tmp_path):
    for name in [*sys.modules]:
        if name.split(".")[0] == "scipy" or name.startswith("renet.identification"):
            monkeypatch.delitem(sys.modules, name)
    for name in ("scipy", "scipy.optimize"):
        monkeypatch.setitem(sys.modules, name, None)
    assert main(["identify", "log.csv", "--robot", "go2"]) == 2
    err = capsys.readouterr().err
    assert "`renet identify` needs scipy.optimize: in a clone of renet, run pip install" in err
    assert "[train]" in err


def test_a_recording_of_another_robot_is_refused(tmp_path, capsys):
    rows = np.zeros(12, TICK_DTYPE)
    rows["now"] = 0.02 * np.arange(12)
    rows["state"] = GOOD
    rows["stiffness"] = 20.0
    log = tmp_path / "recording.mcap"
    arguments = ["identify", str(log), "--out", str(tmp_path / "motors.json"), "--robot", "go2"]
    log.write_bytes(recording([(Topic.RUN, b'{"robot": "go1"}')], messages(rows)))
    assert main(arguments) == 2
    assert "the log is of a Unitree Go1, not of a Unitree Go2" in capsys.readouterr().err
    # Simulated robots are not named.
    log.write_bytes(recording([(Topic.RUN, b'{"robot": "mujoco"}')], messages(rows)))
    assert main(arguments) == 2
    assert "the log has 0.2 s" in capsys.readouterr().err


@pytest.mark.parametrize("group", ["renet.robots", "mjlab.tasks"])
def test_a_robot_of_another_package_is_known(tmp_path, monkeypatch, capsys, group):
    info = tmp_path / "mine-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: mine\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[{group}]\nmine = described\n")
    described = "from dataclasses import replace\nfrom renet.robots import GO2, register_robot\n"
    described += "register_robot(replace(GO2, name='My dog'))\n"
    (tmp_path / "described.py").write_text(described)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "described", raising=False)
    monkeypatch.setitem(robot._ROBOTS, "My dog", None)  # Taken out again at the end.
    del robot._ROBOTS["My dog"]
    assert main(["identify", str(tmp_path / "no.csv"), "--robot", "dog"]) == 2
    assert "no.csv" in capsys.readouterr().err


def test_robots_by_name():
    assert look_up_robot("GO1").name == look_up_robot("Unitree Go1").name == "Unitree Go1"
    with pytest.raises(RenetError, match="unknown robot 'unitree'"):
        look_up_robot("unitree")


def test_options_have_no_trap():
    with pytest.raises(RenetError, match="fit-share"):
        IdentifyCfg(log=None, robot="go2", fit_share=float("nan"))
