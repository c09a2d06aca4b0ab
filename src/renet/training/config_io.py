"""Dataclass configurations to and from plain dictionaries (rsl_rl, checkpoints)."""

from __future__ import annotations

from dataclasses import fields
from typing import Any, TypeVar, get_type_hints

from renet.errors import RenetError

T = TypeVar("T")


def from_dict(cls: type[T], values: dict[str, Any]) -> T:
    """Build a dataclass; lists become tuples where the field is one.

    Raises:
        RenetError: a key is unknown, which means a file of another version.
    """
    hints = get_type_hints(cls)
    known = {f.name for f in fields(cls)}  # type: ignore[arg-type]
    unknown = sorted(set(values) - known)
    if unknown:
        raise RenetError(
            f"{cls.__name__} has no field {', '.join(unknown)}: the configuration was written by "
            "another version of renet"
        )
    return cls(
        **{
            name: tuple(value) if str(hints[name]).startswith("tuple") else value
            for name, value in values.items()
        }
    )
