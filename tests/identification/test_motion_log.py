import numpy as np
import pytest

from renet.deploy.recording.channels import Topic
from renet.deploy.recording.tick import GOOD, TICK_DTYPE
from renet.errors import RenetError
from renet.identification.motion_log import CsvCfg, read_motion_log
from renet.interface import JOINTS
from renet.motors import KINDS

from ..hostile.files import EMPTY, messages
from ..hostile.files import recording as recording_of
from .conftest import KD, KP, named, write_csv

NUMBERED = CsvCfg(
    target="jpos{number}_des",
    position="jpos{number}",
    velocity="jvel{number}",
    rate=200.0,
    legs=("FL", "FR", "RL", "RR"),
)


@pytest.fixture
def short(motion) -> dict[str, np.ndarray]:
    return {quantity: values[:50] for quantity, values in motion.items()}


def test_named_columns(short, tmp_path):
    log = read_motion_log(write_csv(tmp_path / "log.csv", named(short)), CsvCfg())
    for quantity, values in short.items():
        np.testing.assert_allclose(getattr(log, quantity), values, atol=1e-7)
    np.testing.assert_array_equal([log.stiffness, log.damping], [[KP] * 12, [KD] * 12])
    assert log.period == pytest.approx(0.005)
    assert len(log) == 50
    assert log.seconds == pytest.approx(0.25)


def test_numbered_columns_of_other_legs(short, tmp_path):
    order = [JOINTS.index(f"{leg}_{kind}_joint") for leg in NUMBERED.legs for kind in KINDS]
    columns = {"state": np.zeros(50), "kp": np.full(50, KP)}
    for template, quantity in (("{}_des", "target"), ("{}", "position")):
        for number, column in enumerate(order):
            columns[f"jpos{template.format(number)}"] = short[quantity][:, column]
    for number, column in enumerate(order):
        columns[f"jvel{number}"] = short["velocity"][:, column]
    path = write_csv(tmp_path / "log.csv", columns)
    cfg = CsvCfg(**(vars(NUMBERED) | {"kd": (0.5, 0.6, 0.7)}))
    log = read_motion_log(path, cfg)
    for quantity, values in short.items():
        np.testing.assert_allclose(getattr(log, quantity), values, atol=1e-7)
    np.testing.assert_array_equal(log.damping, [0.5, 0.6, 0.7] * 4)
    with pytest.raises(RenetError, match=r"no column 'kd': give --kd"):
        read_motion_log(path, NUMBERED)


def test_gains_of_each_joint(short, tmp_path):
    columns = named(short)
    for number, joint in enumerate(JOINTS):
        columns[f"{joint}_kp"] = np.full(50, 10.0 + number)
    log = read_motion_log(write_csv(tmp_path / "log.csv", columns), CsvCfg())
    np.testing.assert_array_equal(log.stiffness, 10.0 + np.arange(12))


def put(name, row, value):
    def change(columns):
        columns[name][row] = value

    return change


def stall(columns):
    columns["time"][30:] += 0.02


def milliseconds(columns):
    columns["time"] *= 1000.0


def milliseconds_since_1970(columns):
    columns["time"] = 1000.0 * (1.7e9 + columns["time"])


def backwards(columns):
    columns["time"] = columns["time"][::-1]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c.pop("RL_hip_joint_velocity"), "no column 'RL_hip_joint_velocity': is it '"),
        (lambda c: c.pop("time"), "no column 'time'"),
        (lambda c: c.pop("kp"), "no column 'kp': give --kp"),
        (put("FR_calf_joint_position", 7, np.nan), "'FR_calf_joint_position' is nan in line 9"),
        (put("FL_hip_joint_target", 3, np.inf), "'FL_hip_joint_target' is inf in line 5"),
        (put("kd", 20, 0.6), "Kp or Kd changes in line 22"),
        (lambda c: c.update(kd=-c["kd"]), "Kp or Kd is negative"),
        (stall, r"time steps are unequal: 0.025 s after line 31, mostly 0.005 s"),
        (milliseconds, "rows are 5 s apart: the time must be in seconds"),
        (milliseconds_since_1970, "rows are 5 s apart: the time must be in seconds"),
        (lambda c: c.update(kp=0.0 * c["kp"]), "Kp of FR_hip_joint is 0"),
        (backwards, "rows are -0.005 s apart"),
        (lambda c: c.update({n: v[:1] for n, v in c.items()}), "it has no rows"),
    ],
)
def test_bad_columns(short, tmp_path, change, message):
    columns = named(short)
    change(columns)
    path = write_csv(tmp_path / "log.csv", columns)
    with pytest.raises(RenetError, match=message) as error:
        read_motion_log(path, CsvCfg())
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda text: "", "no column 'kp'"),
        (lambda text: text.splitlines()[0], "it has no rows"),
        (lambda text: text[:-20], "rows must have 39 values"),
        (lambda text: text.replace("\n3.01,", "\n3.01,,", 1), "rows must have 39 values"),
        (lambda text: text.replace("\n3.01,", "\n,", 1), "could not convert string"),
        (lambda text: text.replace("\n3.01,", "\nlater,", 1), "could not convert string 'later'"),
        (lambda text: text.replace("kd", "kp", 1), "no column 'kd'"),
        (lambda text: text.replace("kd\n", "kd,kd\n").replace("0.5\n", "0.5,0.5\n"), "2 columns"),
        (
            lambda text: text.replace(",", ";").replace(".", ","),
            "columns are separated by semicolons: take commas, and points in numbers",
        ),
        (lambda text: text.replace(",", "\t"), "columns are separated by tabs"),
        (lambda text: "a" * 100_000, "no header of a CSV file"),
        (lambda text: "\x00\x01\n" + text, "no header of a CSV file"),
    ],
)
def test_damaged_text(short, tmp_path, edit, message):
    path = write_csv(tmp_path / "log.csv", named(short))
    path.write_text(edit(path.read_text()))
    with pytest.raises(RenetError, match=message) as error:
        read_motion_log(path, CsvCfg())
    assert "\n" not in str(error.value)


def test_what_is_no_csv(tmp_path):
    (tmp_path / "a.csv").write_bytes(b"\xff\xfe\x00\x01" * 9)
    (tmp_path / "b.mcap").write_bytes(b"\x89MCAP0\r\n")
    (tmp_path / "c.log").write_bytes(b"RENETLOG4\n")
    with pytest.raises(RenetError, match="first line is not text"):
        read_motion_log(tmp_path / "a.csv", CsvCfg())
    with pytest.raises(RenetError, match="has no readable header"):
        read_motion_log(tmp_path / "b.mcap", CsvCfg())
    with pytest.raises(RenetError, match=r"recording of renet 0\.1: only that version reads it"):
        read_motion_log(tmp_path / "c.log", CsvCfg())
    with pytest.raises(RenetError, match="cannot read the log"):
        read_motion_log(tmp_path / "none.csv", CsvCfg())


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"target": "q_des"}, "'q_des' names one column for several joints"),
        ({"legs": ("FR", "FL", "RR")}, "--legs must name FR, FL, RR, RL"),
        ({"rate": 10.0}, "--rate must be from 40 to 100000 Hz, got 10"),
        ({"kp": (1.0, 2.0)}, "--kp takes one number, or three"),
        ({"kd": (float("nan"),)}, "--kd takes one number, or three"),
    ],
)
def test_bad_options(fields, message):
    with pytest.raises(RenetError, match=message):
        CsvCfg(**fields).columns(CsvCfg(**fields).target)


def recording(motion, header=EMPTY, **changes) -> bytes:
    """A recording of 12 ticks, of which the first three only brake."""
    rows = np.zeros(12, TICK_DTYPE)
    rows["now"] = 5.0 + 0.02 * np.arange(12)
    rows["state"] = GOOD
    rows["position"] = motion["target"][:48:4]
    rows["joint_position"] = motion["position"][:48:4]
    rows["joint_velocity"] = motion["velocity"][:48:4]
    rows["stiffness"] = KP
    rows["damping"] = KD
    rows["stiffness"][:3] = 0.0
    for name, (row, value) in changes.items():
        rows[name][row] = value
    return recording_of(header, messages(rows))


@pytest.mark.parametrize(
    ("changes", "start", "stop"),
    [
        ({}, 3, 12),
        ({"now": (11, 5.3)}, 3, 11),
        ({"state": (4, 0)}, 5, 12),
        ({"damping": (8, 0.7)}, 3, 8),
        ({"joint_position": (9, np.nan)}, 3, 9),
    ],
)
def test_longest_even_part_of_a_recording(short, tmp_path, changes, start, stop):
    path = tmp_path / "recording.mcap"
    path.write_bytes(recording(short, **changes))
    log = read_motion_log(path, CsvCfg())
    np.testing.assert_array_equal(log.target, short["target"][:48:4][start:stop])
    np.testing.assert_array_equal(log.position, short["position"][:48:4][start:stop])
    np.testing.assert_array_equal(log.velocity, short["velocity"][:48:4][start:stop])
    np.testing.assert_array_equal([log.stiffness[0], log.damping[0]], [KP, KD])
    assert log.period == 0.02


def test_bad_recording(short, tmp_path):
    path = tmp_path / "recording.mcap"
    path.write_bytes(recording(short))
    with pytest.raises(RenetError, match="leave --kp and --kd out"):
        read_motion_log(path, CsvCfg(kp=(20.0,)))
    path.write_bytes(recording(short, stiffness=(slice(None), 0.0)))
    with pytest.raises(RenetError, match="no two of its ticks"):
        read_motion_log(path, CsvCfg())
    path.write_bytes(recording(short, [(Topic.RUN, b'{"dry_run": true}')]))
    with pytest.raises(RenetError, match="of a dry run: its targets were never sent to the robot"):
        read_motion_log(path, CsvCfg())
