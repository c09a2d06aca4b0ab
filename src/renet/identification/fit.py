"""Fit of motors to a log by least squares between replayed and measured joint positions."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from renet.errors import RenetError
from renet.identification.motion_log import MotionLog
from renet.identification.replay import SuspendedRobot
from renet.interface import JOINTS
from renet.motors import KINDS, LARGEST, PARAMETERS, joint_kind

KIND_INDEX = np.array([KINDS.index(joint_kind(joint)) for joint in JOINTS])
"""Index in `motors.KINDS` of each joint's kind, [12]."""
SCALE = np.array([0.01, 0.2, 0.3, 0.003])
"""Sizes of the parameters of a small robot's motors, in the units of `motors.MotorParameters`."""
DIFFERENCE = 0.01
"""Step of finite differences, as a share of a parameter's scale."""
LEAST = np.array([1e-5, 0.0, 0.0, 0.0])
"""Smallest values of the parameters; a motor's armature is above zero."""
AT_LEAST = 0.01
"""Distance from its smallest value within which a parameter counts as being there, as a share of
its scale."""
MOST = np.array([getattr(LARGEST, name) for name in PARAMETERS])
"""Largest values of the parameters."""
TOLERANCE = 1e-4
"""Relative change of cost or parameters below which a fit has converged."""
MAX_ITERATIONS = 50
WARM_UP = 0.5
"""Duration of a replay's beginning that is left out, s: the measured start of a joint is
inaccurate."""
END_STOP = 0.2
"""Time for which a joint is left out after a target beyond its limits, s: its end stop, or the
vendor's own limit, holds it then rather than its motor."""
BLOCK_DURATION = 1.0
"""Duration of blocks of errors that count as independent of each other, s."""
LEAST_MOTION = 0.05
"""Smallest range of a joint's motion from which its motor can be fitted, rad."""


@dataclass(frozen=True)
class Fit:
    """Fitted motors of G groups of joints."""

    motors: np.ndarray
    """Values of `motors.PARAMETERS`, [G, 4]."""
    standard_error: np.ndarray
    """Their standard errors, [G, 4]; NaN where a parameter is at its smallest value."""
    iterations: int
    """Number of iterations of the fit."""


def valid_rows(robot: SuspendedRobot, log: MotionLog) -> np.ndarray:
    """Return a mask of the rows from which a joint's motor can be fitted, [T, 12] bool.

    It is False for a time after each target beyond the joint's limits.
    """
    is_beyond = (log.target < robot.lower) | (log.target > robot.upper)
    # Numbers of targets beyond the limits before each row.
    count = np.concatenate([np.zeros((1, len(JOINTS)), int), np.cumsum(is_beyond, axis=0)])
    rows = np.arange(len(log))
    earliest = np.maximum(rows - round(END_STOP / log.period), 0)
    return count[rows + 1] == count[earliest]


def per_joint(motors: np.ndarray) -> np.ndarray:
    """Return a row of motors for each joint, [12, 4], given one for each kind or for each joint."""
    if len(motors) == len(KINDS):
        return motors[KIND_INDEX]
    return motors


def per_kind(motors: np.ndarray) -> np.ndarray:
    """Average the motors of each kind of joint over the legs: [12, 4] to [3, 4]."""
    return np.stack([motors[kind == KIND_INDEX].mean(axis=0) for kind in range(len(KINDS))])


def check_motion(log: MotionLog, rows: range, is_valid: np.ndarray) -> None:
    """Raise RenetError unless every joint moves in the rows that are fitted."""
    for column, joint in enumerate(JOINTS):
        position = log.position[rows.start : rows.stop, column]
        seen = position[is_valid[rows.start : rows.stop, column]]
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
        """Initialize the fit.

        Args:
            robot: The robot.
            log: The log.
            rows: Rows of the log to fit to.
            say: Function that reports progress in a line.
        """
        self._robot = robot
        self._log = log
        self._rows = rows
        self._say = say
        self._weight = valid_rows(robot, log)[rows.start : rows.stop].astype(float)
        self._weight[: round(WARM_UP / log.period)] = 0.0
        self._iterations = 0

    def fit(self, start: np.ndarray) -> Fit:
        """Fit motors, starting from `start`, [G, 4]: one row for each kind or for each joint."""
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
        block = max(1, round(BLOCK_DURATION / self._log.period)) * len(JOINTS)
        error[free] = standard_error(result.fun, result.jac[:, free], block)
        return Fit(motors, error.reshape(groups, -1), self._iterations)

    def errors(self, parameters: np.ndarray) -> np.ndarray:
        """Compute the weighted errors of a replay, [T * 12] rad."""
        table = per_joint(parameters.reshape(-1, len(PARAMETERS)))
        return self._replay_errors([table])[0].ravel()

    def _replay_errors(self, tables: list[np.ndarray]) -> np.ndarray:
        """Compute weighted errors of replays with N tables of motors [12, 4], [N, T, 12] rad."""
        measured = self._log.position[self._rows.start : self._rows.stop]
        return (self._robot.replay(tables, self._rows) - measured) * self._weight

    def jacobian(self, parameters: np.ndarray) -> np.ndarray:
        """Compute derivatives of the errors, [T * 12, G * 4].

        This takes one replay for each kind and parameter, also where each joint has its own motor:
        the trunk is fixed, so that legs do not act on each other and vary at the same time.
        """
        groups = len(parameters) // len(PARAMETERS)
        table = per_joint(parameters.reshape(groups, -1))
        steps = DIFFERENCE * SCALE
        tables = [table]
        for kind in range(len(KINDS)):
            for number, step in enumerate(steps):
                other = table.copy()
                other[kind == KIND_INDEX, number] += step
                tables.append(other)
        base, *others = self._replay_errors(tables)
        self._iterations += 1
        self._say(f"iteration {self._iterations}: RMSE {self._rmse(base):.5f} rad")
        slopes = (np.stack(others) - base).reshape(len(KINDS), len(PARAMETERS), *base.shape)
        slopes /= steps[:, None, None]
        if groups == len(KINDS):
            columns = slopes
        else:
            # Of its kind's slopes, a joint's motor causes those of its own leg.
            leg = np.arange(len(JOINTS)) // len(KINDS)
            same_leg = leg[:, None] == leg
            columns = slopes[KIND_INDEX] * same_leg[:, None, None, :]
        return columns.reshape(groups * len(PARAMETERS), -1).T

    def _rmse(self, errors: np.ndarray) -> float:
        return float(np.sqrt((errors**2).sum() / self._weight.sum()))


def standard_error(errors: np.ndarray, jacobian: np.ndarray, block: int) -> np.ndarray:
    """Compute standard errors of fitted parameters.

    This is the sandwich estimator with blocks as clusters (Liang and Zeger, 1986), because errors
    of neighbouring rows are not independent.

    Args:
        errors: Errors of the fit, [M].
        jacobian: Their derivatives with respect to the parameters, [M, P].
        block: Number of errors in a block.

    Returns:
        Standard errors in the units of the parameters, [P].
    """
    starts = np.arange(0, len(errors), block)
    pull = np.add.reduceat(jacobian * errors[:, None], starts, axis=0)
    inverse = np.linalg.pinv(jacobian.T @ jacobian)
    covariance = inverse @ (pull.T @ pull) @ inverse
    degrees = max(len(starts) - 1, 1)
    return np.sqrt(np.diag(covariance) * len(starts) / degrees)
