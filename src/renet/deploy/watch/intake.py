"""Which readings a controller believes: single odd ones are left out, and three brake."""

from renet.bundle.manifest import RobotSpec
from renet.deploy.robots.base import RobotState
from renet.deploy.safety.checks import clean_state, state_problem
from renet.deploy.safety.limits import SafetyCfg
from renet.deploy.safety.plausibility import LONGEST, Readings, break_problem, comparable

MOST_ODD = 2
"""Odd readings that are left out; meanwhile the last good one stands, and grows old."""
CALM = 10
"""Good readings in a row after which earlier odd ones are forgotten."""
ACCEPTED = 50
"""Readings, 1 s, that agree with each other and not with those before, after which they are
believed: a joint that slipped brakes the robot, but it may be armed again."""
TWICE = 0.1
"""Seconds after the last good reading within which others may be found to go on from it."""


class Intake:
    """Takes a robot's readings in, and keeps the newest good one."""

    def __init__(self, robot: RobotSpec, cfg: SafetyCfg) -> None:
        self._robot = robot
        self._cfg = cfg
        self.newest: RobotState | None = None
        """The newest good reading; None before the first."""
        self._seen: RobotState | None = None
        """The newest whole one, good or not."""
        self._readings = Readings()
        # Where old readings may pass, their times say too little to add up what they foretell.
        self._timed = cfg.max_state_age <= LONGEST
        self._broken = ""
        """Why the newest reading does not go on from the good ones; empty if it does."""
        self._since = 0
        """Readings since it has not."""
        self._drifts = ""
        self._reason = "no state from the robot"
        self._odd = self._good = 0

    def offer(self, raw: RobotState | None, now: float) -> RobotState | None:
        """Take a reading in at `now`, s; returns it cleaned if it is new and whole, else None."""
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
        if self._good >= CALM:
            self._odd = 0
        return state

    def problem(self, now: float) -> str:
        """Why the readings so far forbid motion at `now`, s; empty if they do not."""
        if self.newest is None or self._odd > MOST_ODD:
            return self._reason
        return state_problem(self.newest, self._robot, self._cfg, now) or self._drifts

    def _leave_out(self, reason: str) -> None:
        self._reason = reason
        self._odd += 1
        self._good = 0

    def _follow(self, state: RobotState) -> str:
        """Why a reading must be left out, alone or because it does not go on from those before."""
        last, before = self._seen, self._broken
        self._drifts = ""
        # The age is judged at every step, not here.
        problem = state_problem(state, self._robot, self._cfg, state.time)
        if last is None or self.newest is None or not comparable(last, state):
            self._broken = ""
            self._readings.start_over()
            return problem
        broken = break_problem(last, state)
        if not before:
            self._broken, self._since = broken, 0
        elif self._goes_on(state) if broken else self._since >= ACCEPTED:
            self._broken = ""
        else:
            self._since += 1
        if before or broken or problem or last is not self.newest or not self._timed:
            self._readings.start_over()
        else:
            self._drifts = self._readings.problem(last, state)
        return problem or self._broken

    def _goes_on(self, state: RobotState) -> bool:
        """Whether a reading goes on from the last good one."""
        good = self.newest
        return (
            good is not None and comparable(good, state, TWICE) and not break_problem(good, state)
        )
