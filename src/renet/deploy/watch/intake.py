"""Acceptance of readings: one or two odd ones are left out, and a third one brakes the robot."""

from renet.bundle.manifest import RobotSpec
from renet.deploy.robots.base import RobotState
from renet.deploy.safety.checks import clean_state, state_problem
from renet.deploy.safety.limits import SafetyCfg
from renet.deploy.watch.plausibility import (
    MAX_INTERVAL,
    Disagreement,
    break_problem,
    comparable,
)

_MAX_ODD = 2
"""Largest number of odd readings that are left out; meanwhile the last good one stays, and ages."""
RECOVERY = 10
"""Number of good readings in a row after which earlier odd ones no longer count."""
ACCEPTANCE = 50
"""Number of readings, 1 s, that must agree with each other to be accepted although they do not
continue the earlier ones. A joint that slipped brakes the robot, which may then be armed again."""
_MAX_GAP = 0.1
"""Longest time after the last good reading, s, within which another can continue it."""


class Intake:
    """Checks a robot's readings, and keeps the newest good one."""

    def __init__(self, robot: RobotSpec, cfg: SafetyCfg) -> None:
        self._robot = robot
        self._cfg = cfg
        self.newest: RobotState | None = None
        """The newest good reading; None before the first."""
        self._seen: RobotState | None = None
        """Newest well-formed reading, good or odd."""
        self._disagreement = Disagreement()
        # Where old readings are allowed, their times are too coarse to add up small differences.
        self._timed = cfg.max_state_age <= MAX_INTERVAL
        self._broken = ""
        """Reason why the newest reading does not continue the good ones; empty if it does."""
        self._since = 0
        """Number of readings since the break."""
        self._drifts = ""
        """Slow contradiction among the good readings; empty if there is none."""
        self._reason = "no state from the robot"
        self._odd = 0
        """Number of readings that were left out."""
        self._good = 0
        """Number of good readings since the last one that was left out."""

    def offer(self, raw: RobotState | None, now: float) -> RobotState | None:
        """Check a reading at `now`, s; returns it as float arrays if it is new and well-formed."""
        if raw is None:
            return None
        try:
            state = clean_state(raw, now)
        except Exception as error:  # A driver's object may fail in any way.
            self._leave_out(str(error))
            return None
        if self._seen is not None and state.time <= self._seen.time:
            return None
        problem = self._follow(state)
        self._seen = state
        if problem:
            self._leave_out(problem)
            return state
        self.newest = state
        self._good += 1
        if self._good >= RECOVERY:
            self._odd = 0
        return state

    def problem(self, now: float) -> str:
        """Return why the readings so far forbid motion at `now`, s; empty if they do not."""
        if self.newest is None or self._odd > _MAX_ODD:
            return self._reason
        return state_problem(self.newest, self._robot, self._cfg, now) or self._drifts

    def _leave_out(self, reason: str) -> None:
        self._reason = reason
        self._odd += 1
        self._good = 0

    def _follow(self, state: RobotState) -> str:
        """Return why a reading must be left out; empty if it is good.

        It is beyond a limit, or there was a break: it does not continue the good readings.
        """
        last = self._seen
        before = self._broken
        self._drifts = ""
        # The age is judged at every step, not here.
        problem = state_problem(state, self._robot, self._cfg, state.time)
        # After a pause there is nothing to compare with.
        if last is None or self.newest is None or not comparable(last, state):
            self._broken = ""
            self._disagreement.start_over()
            return problem
        broken = break_problem(last, state)
        # A break ends as soon as a reading continues the last good one again, or once the readings
        # after the break have agreed with each other for long enough.
        ends = self._continues(state) if broken else self._since >= ACCEPTANCE
        if not before:
            self._broken = broken
            self._since = 0
        elif ends:
            self._broken = ""
        else:
            self._since += 1
        # Small differences are added up over an unbroken row of good readings only.
        if before or broken or problem or last is not self.newest or not self._timed:
            self._disagreement.start_over()
        else:
            self._drifts = self._disagreement.problem(last, state)
        return problem or self._broken

    def _continues(self, state: RobotState) -> bool:
        """Return True if a reading continues the last good one."""
        good = self.newest
        if good is None or not comparable(good, state, _MAX_GAP):
            return False
        return not break_problem(good, state)
