"""Checks of the battery's charge, of motor temperatures, and of faults that a robot reports."""

from contextlib import suppress

from renet.deploy.robots.base import RobotState
from renet.deploy.safety.checks import EMPTY, OVERHEATED, power_problem
from renet.deploy.safety.limits import SafetyCfg

_CONFIRMATIONS = 3
"""Number of readings in a row that must agree, because single ones may arrive damaged."""


class PowerWatch:
    """Warns near the limits of battery and motors, and lets a robot lie down before they fail."""

    def __init__(self, cfg: SafetyCfg) -> None:
        self._cfg = cfg
        self._newest: float | None = None
        self._warned = 0
        """Number of readings in a row near the limits."""
        self._ended = 0
        """Number of readings in a row at which the robot must lie down."""
        self.warning = ""
        """Message to the operator; empty while there is nothing to say."""
        self.end = ""
        """Reason why the robot must lie down; empty while it need not."""

    def look(self, state: RobotState | None) -> None:
        """Check the newest reading; the same one again counts once."""
        time = getattr(state, "time", None)  # A driver's object may be anything.
        if time is None or time == self._newest:
            return
        self._newest = time
        cfg = self._cfg
        warning = ""
        end = ""
        with suppress(TypeError):  # What a driver reports may be no number.
            warning = power_problem(state, cfg.min_battery, cfg.max_temperature)
            lowest = min(EMPTY, cfg.min_battery)
            end = power_problem(state, lowest, cfg.max_temperature + OVERHEATED)
        end = end or getattr(state, "fault", "")
        self._warned = self._warned + 1 if warning else 0
        self._ended = self._ended + 1 if end else 0
        self.warning = warning if self._warned >= _CONFIRMATIONS else ""
        self.end = end if self._ended >= _CONFIRMATIONS else ""
