"""Conversion of JSON values to dataclasses. msgspec checks their types."""

import math
from typing import Any, TypeVar

import msgspec

from renet.errors import RenetError, printable

_T = TypeVar("_T")
MAX_TEXT = 500
"""Most characters of a text in a file."""


def from_json(kind: type[_T], value: Any, source: str, remedy: str) -> _T:
    """Build a dataclass from a JSON value.

    Types are those that its fields declare: no text is taken for a number. Numbers must be finite,
    and texts printable, for a terminal carries out control characters.

    Args:
        kind: The dataclass, whose fields may be dataclasses, tuples and mappings.
        value: The JSON value.
        source: Name of what the value was read from, used in error messages.
        remedy: Advice to the user, used in error messages.

    Raises:
        RenetError: A field is missing, unknown, of another type, not finite or not printable, or
            the dataclass refuses the values. The message names the source, the field, and the
            remedy.
    """
    try:
        _demand_plain(value)
        built = msgspec.convert(value, kind)
        _demand_known(value, msgspec.to_builtins(built))
    except msgspec.ValidationError as error:
        # msgspec ends its messages with the place, such as "- at `$.robot.stiffness[1]`".
        problem, _, place = str(error).partition(" - at `$")
        where = place.strip(".`")
        problem = printable(f"{where}: {problem}" if where else problem)
        raise RenetError(f"cannot use {source}: {problem[:MAX_TEXT]}; {remedy}") from error
    except RenetError as error:
        raise RenetError(f"cannot use {source}: {error}; {remedy}") from error
    return built


def _demand_plain(value: Any, where: str = "") -> None:
    """Raise RenetError for a number that is not finite, or a text that is long or unprintable."""
    if isinstance(value, float) and not math.isfinite(value):
        raise RenetError(f"{where.lstrip('.')} must be a finite number")
    if isinstance(value, str) and (len(value) > MAX_TEXT or not value.isprintable()):
        raise RenetError(f"{where.lstrip('.')} must be at most {MAX_TEXT} printable characters")
    if isinstance(value, dict):
        for key, item in value.items():
            _demand_plain(item, f"{where}.{printable(str(key)[:40])}")
    elif isinstance(value, list | tuple):
        for place, item in enumerate(value):
            _demand_plain(item, f"{where}[{place}]")


def _demand_known(value: Any, known: Any, where: str = "") -> None:
    """Raise RenetError for a field that conversion dropped.

    Args:
        value: JSON value that was converted.
        known: JSON value of the result, with all its fields.
        where: Place of both, used in error messages.
    """
    if isinstance(value, dict):
        for key, item in value.items():
            place = f"{where}.{printable(str(key)[:40])}"
            if key not in known:
                raise RenetError(f"there is no field {place.lstrip('.')!r}")
            _demand_known(item, known[key], place)
    elif isinstance(value, list | tuple):
        for position, pair in enumerate(zip(value, known, strict=True)):
            _demand_known(*pair, f"{where}[{position}]")
