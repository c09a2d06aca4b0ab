"""A battery that is empty, motors that are hot, and what a robot says is wrong with itself."""

from contextlib import suppress

from renet.deploy.robots.base import RobotState
from renet.deploy.safety.checks import EMPTY, OVERHEATED, power_problem
from renet.deploy.safety.limits import SafetyCfg

IN_A_ROW = 3
"""Readings that must say so: single ones arrive damaged."""


class PowerWatch:
    """Warns near the limits of battery and motors, and lets a robot lie down before they fail."""

    def __init__(self, cfg: SafetyCfg) -> None:
        self._cfg = cfg
        self._newest: float | None = None
        self._warned = self._ended = 0
        self.warning = ""
        """What the operator is to know; empty while there is nothing."""
        self.end = ""
        """Why the robot must lie down; empty while it need not."""

    def look(self, state: RobotState | None) -> None:
        """Take in the newest reading; the same one again counts once."""
        time = getattr(state, "time", None)  # A driver's object may be anything.
        if time is None or time == self._newest:
            return
        self._newest = time
        cfg = self._cfg
        warning = end = ""
        with suppress(TypeError):  # What a driver reports may be no number.
            warning = power_problem(state, cfg.min_battery, cfg.max_temperature)
            limits = min(EMPTY, cfg.min_battery), cfg.max_temperature + OVERHEATED
            end = power_problem(state, *limits)
        end = end or getattr(state, "fault", "")
        self._warned = self._warned + 1 if warning else 0
        self._ended = self._ended + 1 if end else 0
        self.warning = warning if self._warned >= IN_A_ROW else ""
        self.end = end if self._ended >= IN_A_ROW else ""
