"""Reads logs of joint targets, positions and velocities: CSV files, and recordings of a run.

A CSV file has a header line, and a column for each joint and quantity, such as
`FR_hip_joint_target` in rad, `FR_hip_joint_position` in rad and `FR_hip_joint_velocity` in rad/s;
`time` in s; and `kp` in N m/rad and `kd` in N m s/rad, which may also be options. Other columns are
ignored.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from itertools import chain
from pathlib import Path

import numpy as np

from renet.deploy.recording.reader import EARLIER, MAGIC, read_recording
from renet.deploy.recording.tick import GOOD
from renet.errors import RenetError
from renet.files import MEGABYTE, read_bytes
from renet.interface import CONTROL_DT, JOINTS, LEGS
from renet.motors import KINDS, joint_kind

MAX_LOG = 100 * MEGABYTE
"""Largest size of a CSV file, bytes: 25 minutes at 200 Hz."""
MAX_HEADER = 65_536
"""Largest size of its first line, bytes."""
LARGEST_NUMBER = 1e20
"""Largest number that is read; a time in nanoseconds since 1970 is 2e18."""
SEPARATORS = {";": "semicolons", "\t": "tabs"}
"""Names of characters that separate columns in place of commas."""
MIN_RATE = 40.0
"""Lowest rate, Hz; at a lower one, the motion between two rows is unknown."""
UNEVEN = 0.1
"""Largest difference between two time steps, as a share of one."""
QUANTITIES = ("target", "position", "velocity")
GAINS = ("kp", "kd")


@dataclass(frozen=True)
class CsvCfg:
    """Names of a CSV file's columns, and what it does not hold.

    In the names of columns, `{joint}` stands for FR_hip_joint, …, `{leg}` for FR, …, `{kind}` for
    hip, thigh or calf, and `{number}` for 0 to 11: hip, thigh and calf of each leg in the order of
    `--legs`.
    """

    target: str = "{joint}_target"
    """Columns of the positions that the joints were told, rad."""
    position: str = "{joint}_position"
    """Columns of the measured positions, rad."""
    velocity: str = "{joint}_velocity"
    """Columns of the measured velocities, rad/s."""
    time: str = "time"
    """Column of the time, s."""
    rate: float | None = None
    """Rows per second, in place of a column of the time."""
    legs: tuple[str, ...] = LEGS
    """Order of the legs in `{number}`."""
    kp: tuple[float, ...] = ()
    """Kp that the servos were told, N m/rad: one, or those of hip, thigh and calf; by default the
    columns `kp`, or `FR_hip_joint_kp`, …"""
    kd: tuple[float, ...] = ()
    """Kd that the servos were told, N m s/rad; likewise."""

    def __post_init__(self) -> None:
        if set(self.legs) != set(LEGS) or len(self.legs) != len(LEGS):
            raise RenetError(f"--legs must name {', '.join(LEGS)}, each once")
        if self.rate is not None and not MIN_RATE <= self.rate <= 1e5:
            raise RenetError(f"--rate must be from {MIN_RATE:g} to 100000 Hz, got {self.rate:g}")
        for name in GAINS:
            values = getattr(self, name)
            if len(values) not in (0, 1, len(KINDS)) or not all(0 <= v < 1e4 for v in values):
                raise RenetError(f"--{name} takes one number, or three: of hip, thigh and calf")

    def columns(self, template: str) -> list[str]:
        """Return the names of a quantity's columns in the order of `interface.JOINTS`."""
        names = []
        for joint in JOINTS:
            leg = joint.split("_")[0]
            number = len(KINDS) * self.legs.index(leg) + KINDS.index(joint_kind(joint))
            name = template.replace("{joint}", joint).replace("{leg}", leg)
            names.append(name.replace("{kind}", joint_kind(joint)).replace("{number}", str(number)))
        if len(set(names)) < len(names):
            raise RenetError(
                f"{template!r} names one column for several joints: put {{joint}} or {{number}} "
                "into it"
            )
        return names


@dataclass(frozen=True)
class MotionLog:
    """Motion of a robot's joints at a constant rate; arrays follow `interface.JOINTS`."""

    period: float
    """Time from one row to the next, s."""
    target: np.ndarray
    """Joint targets, [T, 12] rad; each holds until the next row."""
    position: np.ndarray
    """Joint positions, [T, 12] rad, measured when the row's target was sent."""
    velocity: np.ndarray
    """Joint velocities, [T, 12] rad/s, measured at the same time."""
    stiffness: np.ndarray
    """Kp of the servos, [12] N m/rad."""
    damping: np.ndarray
    """Kd of the servos, [12] N m s/rad."""
    sha256: str = field(default="", repr=False)
    """SHA-256 of the file, hexadecimal."""
    robot: str = ""
    """Name of the driver in a recording's header, such as go1; empty for a CSV file."""

    def __len__(self) -> int:
        return len(self.target)

    @property
    def seconds(self) -> float:
        """Duration of the log, s."""
        return len(self) * self.period


def read_motion_log(path: Path, csv: CsvCfg) -> MotionLog:
    """Read a log of either kind.

    Args:
        path: Path of a CSV file, or of a recording of `renet deploy` (MCAP).
        csv: Names of the CSV file's columns.

    Raises:
        RenetError: The file cannot be read or is of a dry run, a column is missing, a value is not
            finite, time steps are unequal, gains are unknown or change, or a Kp is 0.
    """
    data = read_bytes(path, MAX_LOG, "log")
    sha256 = hashlib.sha256(data).hexdigest()
    try:
        if data.startswith((MAGIC, EARLIER)):
            return _from_recording(path, csv, sha256)
        return _from_csv(data, csv, sha256)
    except RenetError as error:
        raise RenetError(f"cannot use the log {path}: {error}") from error


def _from_csv(data: bytes, csv: CsvCfg, sha256: str) -> MotionLog:
    """Read a CSV file; raises RenetError as `read_motion_log`."""
    header = _read_header(data)
    columns = {name: csv.columns(getattr(csv, name)) for name in QUANTITIES}
    for name in GAINS:
        if not getattr(csv, name):
            columns[name] = _gain_columns(header, name)
    if csv.rate is None:
        columns["time"] = [csv.time]
    names = dict.fromkeys(chain.from_iterable(columns.values()))
    table = _read_columns(data, header, [*names])
    values = {}
    for quantity, members in columns.items():
        values[quantity] = np.stack([table[name] for name in members], axis=1)
    gains = {}
    for name in GAINS:
        given = getattr(csv, name)
        gains[name] = _of_kinds(given) if given else _constant(values[name])
    _demand_stiffness(gains["kp"])
    return MotionLog(
        period=_period(values["time"][:, 0]) if csv.rate is None else 1.0 / csv.rate,
        target=values["target"],
        position=values["position"],
        velocity=values["velocity"],
        stiffness=gains["kp"],
        damping=gains["kd"],
        sha256=sha256,
    )


def _read_header(data: bytes) -> list[str]:
    """Return the names in a CSV file's first line; raises RenetError if there are none."""
    first_line = data[:MAX_HEADER].partition(b"\n")[0]
    try:
        header = [name.strip().strip('"') for name in first_line.decode("utf-8-sig").split(",")]
    except UnicodeDecodeError as error:
        raise RenetError("its first line is not text: a log is a CSV file") from error
    for separator, name in SEPARATORS.items():
        # Programs in countries of decimal commas separate columns otherwise.
        if len(header) == 1 and separator in header[0]:
            raise RenetError(
                f"its columns are separated by {name}: take commas, and points in numbers"
            )
    if len(first_line) == MAX_HEADER or not "".join(header).isprintable():
        raise RenetError("its first line is no header of a CSV file")
    return header


def _of_kinds(values: Sequence[float]) -> np.ndarray:
    """Return a value for each joint, [12], given one for all, or those of hip, thigh and calf."""
    kinds = np.broadcast_to(values, len(KINDS))
    return np.array([kinds[KINDS.index(joint_kind(joint))] for joint in JOINTS])


def _gain_columns(header: list[str], name: str) -> list[str]:
    """Return the names of a gain's twelve columns: the same one for all joints, or one for each."""
    own = [f"{joint}_{name}" for joint in JOINTS]
    if set(own) <= set(header):
        return own
    if name in header:
        return [name] * len(JOINTS)
    raise RenetError(f"there is no column {name!r}: give --{name}, what the servos were told")


def _read_columns(data: bytes, header: list[str], names: list[str]) -> dict[str, np.ndarray]:
    """Read columns of a CSV file.

    Args:
        data: Content of the file.
        header: Names in its first line.
        names: Names of the columns to read.

    Returns:
        Columns [T] by name.

    Raises:
        RenetError: A column is missing or there twice, a row has another number of values, or a
            value is not a finite number.
    """
    for name in names:
        if name not in header:
            nearest = get_close_matches(name, header, n=1)
            hint = f"is it {nearest[0]!r}?" if nearest else f"it has {', '.join(header)[:200]}"
            raise RenetError(f"there is no column {name!r}: {hint}")
        if header.count(name) > 1:
            raise RenetError(f"there are {header.count(name)} columns {name!r}")
    places = [header.index(name) for name in names]
    try:
        lines = data.decode().splitlines()[1:]
        if len(lines) < 2:
            raise RenetError("it has no rows")
        # All columns are counted, so that a row that was cut short does not pass.
        counts = {line.count(",") + 1 for line in lines if line.strip()}
        if len(counts) > 1 or counts - {len(header)}:
            raise RenetError(f"its rows must have {len(header)} values, as its header has")
        values = np.loadtxt(lines, delimiter=",", usecols=places, ndmin=2, comments=None)
    # Bytes that are no text raise it, too.
    except ValueError as error:
        raise RenetError(str(error).splitlines()[0]) from error
    bad = np.argwhere(~np.isfinite(values) | (np.abs(values) > LARGEST_NUMBER))
    if len(bad):
        row, column = bad[0]
        raise RenetError(f"{names[column]!r} is {values[row, column]} in line {row + 2}")
    return dict(zip(names, values.T, strict=True))


def _period(time: np.ndarray) -> float:
    """Return the time between rows, s, from their times [T]; raises RenetError if it varies."""
    steps = np.diff(time)
    period = float(np.median(steps))
    if not 0.0 < period <= 1.0 / MIN_RATE:
        raise RenetError(
            f"its rows are {period:g} s apart: the time must be in seconds, and the rate at least "
            f"{MIN_RATE:g} Hz"
        )
    row = int(np.abs(steps - period).argmax())
    if abs(steps[row] - period) > UNEVEN * period:
        raise RenetError(
            f"its time steps are unequal: {steps[row]:.6g} s after line {row + 2}, mostly "
            f"{period:.6g} s: resample it"
        )
    return float(time[-1] - time[0]) / len(steps)


def _constant(gains: np.ndarray) -> np.ndarray:
    """Return the gains [12] of rows [T, 12]; raises RenetError if they change or are negative."""
    changed = (gains != gains[0]).any(axis=1)
    if changed.any():
        raise RenetError(f"Kp or Kd changes in line {int(changed.argmax()) + 2}: cut it there")
    if (gains[0] < 0.0).any():
        raise RenetError("Kp or Kd is negative")
    return gains[0]


def _demand_stiffness(stiffness: np.ndarray) -> None:
    """Raise RenetError for a joint without Kp, [12] N m/rad, which follows no target."""
    for joint, value in zip(JOINTS, stiffness, strict=True):
        if value == 0.0:
            raise RenetError(f"Kp of {joint} is 0: a joint must follow its targets")


def _from_recording(path: Path, csv: CsvCfg, sha256: str) -> MotionLog:
    """Read the longest part of a recording that has constant gains, all readings and no gap."""
    if csv.kp or csv.kd:
        raise RenetError("it is a recording, which holds Kp and Kd: leave --kp and --kd out")
    run = read_recording(path)
    if run.header.get("dry_run"):
        raise RenetError("it is of a dry run: its targets were never sent to the robot")
    ticks = run.ticks
    gains = np.concatenate([ticks["stiffness"], ticks["damping"]], axis=1)
    readings = [ticks[name] for name in ("joint_position", "joint_velocity", "position")]
    usable = (ticks["state"] == GOOD) & (ticks["stiffness"] > 0.0).all(axis=1)
    usable &= np.isfinite(np.concatenate([gains, *readings], axis=1)).all(axis=1)
    # True where a tick goes on from the one before, so that the two belong together.
    even = np.abs(np.diff(ticks["now"]) - CONTROL_DT) <= UNEVEN * CONTROL_DT
    follows = usable[1:] & usable[:-1] & even & (gains[1:] == gains[:-1]).all(axis=1)
    breaks = np.flatnonzero(~np.concatenate([[False], follows, [False]]))
    if not follows.any():
        raise RenetError("no two of its ticks have readings and the same Kp and Kd")
    longest = int(np.diff(breaks).argmax())
    rows = slice(breaks[longest], breaks[longest + 1])
    return MotionLog(
        period=CONTROL_DT,
        target=ticks["position"][rows],
        position=ticks["joint_position"][rows],
        velocity=ticks["joint_velocity"][rows],
        stiffness=ticks["stiffness"][rows][0],
        damping=ticks["damping"][rows][0],
        sha256=sha256,
        robot=str(run.header.get("robot", "")),
    )
