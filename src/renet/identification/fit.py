"""Fits motors to a log by least squares: those whose replay comes closest to what was measured."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from renet.errors import RenetError
from renet.identification.motion_log import MotionLog
from renet.identification.replay import SuspendedRobot
from renet.interface import JOINTS
from renet.motors import KINDS, LARGEST, PARAMETERS, joint_kind

KIND = np.array([KINDS.index(joint_kind(joint)) for joint in JOINTS])
"""Place in `motors.KINDS` of each joint, [12]."""
SCALE = np.array([0.01, 0.2, 0.3, 0.003])
"""Sizes of the parameters of a small robot's motors, in the units of `motors.MotorParameters`."""
DIFFERENCE = 0.01
"""Share of its scale by which a parameter is varied to measure its influence."""
LEAST = np.array([1e-5, 0.0, 0.0, 0.0])
"""Least values; an armature of zero is no motor."""
AT_LEAST = 0.01
"""Share of its scale within which a parameter is at its least value."""
MOST = np.array([getattr(LARGEST, name) for name in PARAMETERS])
TOLERANCE = 1e-4
"""Relative change of cost or parameters below which a fit has converged."""
MAX_ITERATIONS = 50
WARM_UP = 0.5
"""Seconds at the beginning of a replay that are not judged: a joint's start is measured badly."""
END_STOP = 0.2
"""Seconds for which a joint is not judged after a target beyond its limits: its end stop, or its
vendor's own limit, holds it then, not its motor."""
BLOCK = 1.0
"""Seconds of errors that are taken for independent of those before and after them."""
LEAST_MOTION = 0.05
"""rad; a joint that moves less says nothing of its motor."""


@dataclass(frozen=True)
class Fit:
    """Motors that were fitted, for each of G groups of joints."""

    motors: np.ndarray
    """[G, 4] of `motors.PARAMETERS`."""
    standard_error: np.ndarray
    """[G, 4] likewise; NaN where a parameter is at its least value."""
    iterations: int


def judged(robot: SuspendedRobot, log: MotionLog) -> np.ndarray:
    """Which joints say something of their motors in which rows, [T, 12]."""
    beyond = (log.target < robot.lower) | (log.target > robot.upper)
    count = np.concatenate([np.zeros((1, len(JOINTS)), int), np.cumsum(beyond, axis=0)])
    rows = np.arange(len(log))
    earliest = np.maximum(rows - round(END_STOP / log.period), 0)
    return count[rows + 1] == count[earliest]


def spread(motors: np.ndarray) -> np.ndarray:
    """Motors of each joint, [12, 4], from those of kinds [3, 4] or of joints [12, 4]."""
    return motors[KIND] if len(motors) == len(KINDS) else motors


def check_motion(log: MotionLog, rows: range, is_judged: np.ndarray) -> None:
    """Raise RenetError unless every joint moves in the rows that are fitted."""
    for column, joint in enumerate(JOINTS):
        position = log.position[rows.start : rows.stop, column]
        seen = position[is_judged[rows.start : rows.stop, column]]
        if not len(seen):
            raise RenetError(
                f"every target of {joint} is beyond its limits: are the log's angles in rad, and "
                "its joints in this order?"
            )
        if np.ptp(seen) < LEAST_MOTION:
            raise RenetError(
                f"{joint} moves by {np.ptp(seen):.3f} rad only while motors are fitted: move every "
                "joint"
            )


class MotorFitter:
    """Errors of a log's replay as a function of the motors, and their least squares."""

    def __init__(
        self, robot: SuspendedRobot, log: MotionLog, rows: range, say: Callable[[str], None]
    ) -> None:
        """Set up to fit to some rows of a log; `say` is told of progress."""
        self._robot, self._log, self._rows, self._say = robot, log, rows, say
        self._weight = judged(robot, log)[rows.start : rows.stop].astype(float)
        self._weight[: round(WARM_UP / log.period)] = 0.0
        self._iterations = 0

    def fit(self, start: np.ndarray) -> Fit:
        """Fit, beginning with motors [G, 4] of kinds of joints (G = 3) or of joints (G = 12)."""
        groups = len(start)
        scale = np.tile(SCALE, (groups, 1))
        least = np.tile(LEAST, (groups, 1))
        # The method begins inside the bounds.
        begin = np.maximum(start, least + 0.1 * scale)
        result = least_squares(
            self.errors,
            begin.ravel(),
            jac=self.jacobian,  # pyright: ignore[reportArgumentType]
            bounds=(least.ravel(), np.tile(MOST, groups)),
            x_scale=scale.ravel(),
            ftol=TOLERANCE,
            xtol=TOLERANCE,
            max_nfev=MAX_ITERATIONS,
        )
        motors = result.x.reshape(groups, -1)
        free = (motors > least + AT_LEAST * scale).ravel()
        error = np.full(free.size, np.nan)
        block = max(1, round(BLOCK / self._log.period)) * len(JOINTS)
        error[free] = standard_error(result.fun, result.jac[:, free], block)
        return Fit(motors, error.reshape(groups, -1), self._iterations)

    def errors(self, parameters: np.ndarray) -> np.ndarray:
        """Weighted errors of a replay, flat [T * 12] rad."""
        table = spread(parameters.reshape(-1, len(PARAMETERS)))
        return self._replay_errors([table])[0].ravel()

    def _replay_errors(self, tables: list[np.ndarray]) -> np.ndarray:
        """Weighted errors [N, T, 12] rad of replays with N tables of motors [12, 4]."""
        measured = self._log.position[self._rows.start : self._rows.stop]
        return (self._robot.replay(tables, self._rows) - measured) * self._weight

    def jacobian(self, parameters: np.ndarray) -> np.ndarray:
        """Derivatives [T * 12, G * 4] of the errors, by one replay for each kind and parameter.

        Legs hang from a fixed trunk, where none feels another. So a parameter is varied in all four
        at once, also where each joint has its own.
        """
        groups = len(parameters) // len(PARAMETERS)
        table = spread(parameters.reshape(groups, -1))
        steps = DIFFERENCE * SCALE
        varied = []
        for kind in range(len(KINDS)):
            for number, step in enumerate(steps):
                other = table.copy()
                other[kind == KIND, number] += step
                varied.append(other)
        base, *others = self._replay_errors([table, *varied])
        self._iterations += 1
        self._say(f"iteration {self._iterations}: RMSE {self._rmse(base):.5f} rad")
        slopes = (np.stack(others) - base).reshape(len(KINDS), len(PARAMETERS), *base.shape)
        slopes /= steps[:, None, None]
        if groups == len(KINDS):
            columns = slopes
        else:
            # A joint's own part of its kind's slopes: those of its leg.
            leg = np.arange(len(JOINTS)) // len(KINDS)
            same_leg = leg[:, None] == leg
            columns = slopes[KIND] * same_leg[:, None, None, :]
        return columns.reshape(groups * len(PARAMETERS), -1).T

    def _rmse(self, errors: np.ndarray) -> float:
        return float(np.sqrt((errors**2).sum() / self._weight.sum()))


def standard_error(errors: np.ndarray, jacobian: np.ndarray, block: int) -> np.ndarray:
    """Standard errors of fitted parameters.

    The sandwich estimator with blocks as clusters (Liang and Zeger, 1986): errors of neighbouring
    rows are far from independent.

    Args:
        errors: of the fit, [M].
        jacobian: their derivatives by the parameters, [M, P].
        block: number of errors that belong together.

    Returns:
        [P], in the units of the parameters.
    """
    starts = np.arange(0, len(errors), block)
    pull = np.add.reduceat(jacobian * errors[:, None], starts, axis=0)
    inverse = np.linalg.pinv(jacobian.T @ jacobian)
    covariance = inverse @ (pull.T @ pull) @ inverse
    degrees = max(len(starts) - 1, 1)
    return np.sqrt(np.diag(covariance) * len(starts) / degrees)
