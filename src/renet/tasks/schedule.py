"""Schedules of settings that change during training, as functions of the environment steps taken.

They count environment steps rather than iterations or control steps, so that a schedule means the
same for 64 robots and for 16,384.
"""

import re
from functools import lru_cache

import numpy as np

from renet.errors import RenetError

Schedule = str | float
"""A number, or points `VALUE@STEPS` joined by commas, such as `0.003@10M,0.001@60M`: linear between
points, constant before the first and after the last. STEPS counts environment steps of all robots
and processes since the beginning of the run and may end in k or M."""

_POINT = re.compile(r"([-+0-9.eE]+)@([0-9.]+)([kM]?)")
_UNIT = {"": 1.0, "k": 1e3, "M": 1e6}


def value_at(schedule: Schedule, steps: float) -> float:
    """Return a schedule's value after `steps` environment steps.

    Raises:
        RenetError: The schedule cannot be read, or its points are not in order.
    """
    return float(np.interp(steps, *_points(str(schedule))))


def lowest(schedule: Schedule) -> float:
    """Return the smallest value that a schedule ever has; raises as `value_at` does."""
    return min(_points(str(schedule))[1])


@lru_cache(maxsize=256)
def _points(schedule: str) -> tuple[list[float], list[float]]:
    """Parse a schedule to steps and values of all points; raises as `value_at` does."""
    # A number alone is a schedule of one point.
    texts = (schedule if "@" in schedule else f"{schedule}@0").split(",")
    try:
        points = [_POINT.fullmatch(text.strip()).groups() for text in texts]  # type: ignore[union-attr]
        values = [float(value) for value, _, _ in points]
        steps = [float(number) * _UNIT[unit] for _, number, unit in points]
    except (AttributeError, ValueError) as error:
        raise RenetError(
            f"cannot read the schedule {schedule!r}: write a number, or VALUE@STEPS points joined "
            "by commas, such as 0.003@10M,0.001@60M"
        ) from error
    if sorted(steps) != steps:
        raise RenetError(f"the steps of the schedule {schedule!r} must not fall")
    return steps, values
