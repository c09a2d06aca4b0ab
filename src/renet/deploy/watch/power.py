"""Checks of the battery's charge, of motor temperatures, and of faults that a robot reports."""

from collections.abc import Callable
from contextlib import suppress

from renet.deploy.robots.base import RobotState
from renet.deploy.safety.checks import EMPTY, OVERHEATED, battery_problem, temperature_problem
from renet.deploy.safety.limits import SafetyCfg

_CONFIRMATIONS = 3
"""Number of readings in a row that must agree, because single ones may arrive damaged."""
_CALM = 500
"""Number of readings in a row without a problem, 10 s, after which its warning is over: a
temperature that wavers about its limit must not be told again and again."""


class PowerWatch:
    """Warns near the limits of battery and motors, and lets a robot lie down before they fail."""

    def __init__(self, cfg: SafetyCfg) -> None:
        self._cfg = cfg
        self._newest: float | None = None
        self._battery = _Warning()
        self._motors = _Warning()
        self._ended = 0
        """Number of readings in a row at which the robot must lie down."""
        self.end = ""
        """Reason why the robot must lie down; empty while it need not."""

    @property
    def warning(self) -> str:
        """Message to the operator; empty while there is nothing to say."""
        return "; ".join(filter(None, (self._battery.text, self._motors.text)))

    def look(self, state: RobotState | None) -> None:
        """Check the newest reading; the same one again counts once."""
        time = getattr(state, "time", None)  # A driver's object may be anything.
        if time is None or time == self._newest:
            return
        self._newest = time
        cfg = self._cfg
        self._battery.look(_problem(battery_problem, state, cfg.min_battery))
        self._motors.look(_problem(temperature_problem, state, cfg.max_temperature))
        end = (
            _problem(battery_problem, state, min(EMPTY, cfg.min_battery))
            or _problem(temperature_problem, state, cfg.max_temperature + OVERHEATED)
            or getattr(state, "fault", "")
        )
        self._ended = self._ended + 1 if end else 0
        self.end = end if self._ended >= _CONFIRMATIONS else ""


class _Warning:
    """Warning that begins after a few readings in a row, and lasts until it was calm for long."""

    def __init__(self) -> None:
        self._problems = 0
        """Number of readings in a row with a problem."""
        self._calm = 0
        """Number of readings in a row without one."""
        self.text = ""
        """Problem that is warned of; empty if there is none."""

    def look(self, problem: str) -> None:
        """Count a reading, whose problem is empty if it has none."""
        self._problems = self._problems + 1 if problem else 0
        self._calm = 0 if problem else self._calm + 1
        if self._problems >= _CONFIRMATIONS:
            self.text = problem
        elif self._calm >= _CALM:
            self.text = ""


def _problem(
    check: Callable[[RobotState | None, float], str], state: RobotState | None, limit: float
) -> str:
    """Return what a check says of a reading; empty if the driver reports no number."""
    with suppress(TypeError):
        return check(state, limit)
    return ""
