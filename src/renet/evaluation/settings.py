"""Settings that commands of evaluation have in common: their names, and checks of their values."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any, Final, Literal, get_args

import numpy as np

from renet.errors import RenetError

FLAT_GROUND: Final = "flat"
"""Ground without tiles."""
PARKOUR: Final = "parkour"
"""A field of all tiles at all levels."""
ORACLE: Final = "oracle"
"""Mode that only studies have: VP, and OP exactly while the camera fails."""
StudyMode = Literal["memory", "switch", "camera", "blind", "oracle"]
"""Modes of a study's robots: the pilot's (`interface.PilotMode`), and `ORACLE`."""
Conditions = Literal["nominal", "training"]
"""Conditions other than the ground, see `renet.evaluation.conditions`."""


def check_modes(modes: Sequence[str]) -> None:
    """Raise RenetError unless each mode is a policy mode and is given once."""
    if not modes or not {*modes} <= {*get_args(StudyMode)} or len({*modes}) < len(modes):
        names = ", ".join(modes) or "none"
        choices = ", ".join(get_args(StudyMode))
        raise RenetError(f"modes {names}: choose, once each, among {choices}")


def check_names(setting: str, names: Sequence[str], choices: Collection[str]) -> None:
    """Raise RenetError unless a setting has names, and all of them are among the choices."""
    if not names or not {*names} <= {*choices}:
        raise RenetError(f"{setting} {names}: choose among {', '.join(choices)}")


def check_grounds(levels: Mapping[str, int]) -> None:
    """Raise RenetError unless each ground is flat or a kind of tile, and its level is 1 to 10."""
    from renet.terrain.tiles import find_tile  # Needs MuJoCo; calibration from logs does not.

    for ground, level in levels.items():
        find_tile("rough" if ground == FLAT_GROUND else ground, level)


def check_speed(speed: float) -> None:
    """Raise RenetError unless a commanded speed, m/s, is positive."""
    if not speed > 0:
        raise RenetError(f"speed must be positive, got {speed}")


def check_once(settings: Any) -> None:
    """Raise RenetError for a tuple among a dataclass's fields that has the same value twice.

    The robots of that value would count twice.
    """
    for name, values in vars(settings).items():
        if isinstance(values, tuple) and len({*values}) < len(values):
            twice = next(value for value in values if values.count(value) > 1)
            raise RenetError(f"{name.replace('_', ' ')} has {twice} more than once: give it once")


def check_finite(settings: Any) -> None:
    """Raise RenetError for a field of a dataclass that is infinite or NaN."""
    for name, value in vars(settings).items():
        if isinstance(value, float) and not np.isfinite(value):
            raise RenetError(f"{name.replace('_', ' ')} must be a finite number, got {value}")
