"""What a checkpoint says of its run: both configurations as JSON, and the way back from there."""

import json
from collections.abc import Iterator
from dataclasses import fields, is_dataclass, replace
from enum import Enum
from textwrap import shorten
from typing import Any, TypeVar

from renet.training.config import to_tuples

T = TypeVar("T")
PLAIN = (bool, int, float, str)
UNSAID = ("env.seed", "agent.experiment_name")
"""Settings whose differences are said elsewhere."""


def described(value: Any) -> Any:
    """A configuration as JSON: dataclasses as dictionaries, functions and types by their names."""

    def plain(item: Any) -> Any:
        if is_dataclass(item) and not isinstance(item, type):
            return {f.name: getattr(item, f.name) for f in fields(item)}
        if callable(item):
            return f"{item.__module__}.{getattr(item, '__qualname__', type(item).__name__)}"
        return list(item) if isinstance(item, set) else str(item)

    return json.loads(json.dumps(value, default=plain))


def differences(before: Any, now: Any, name: str) -> Iterator[str]:
    """A line for each place where a run's JSON differs from the one it resumes, as deep as both go.

    `name` stands for both in these lines, with dots between levels.
    """
    before, now = _by_name(before), _by_name(now)
    if isinstance(before, dict) and isinstance(now, dict):
        for key in sorted(before.keys() | now.keys()):
            pair = before.get(key, "absent"), now.get(key, "absent")
            yield from differences(*pair, f"{name}.{key}")
    elif before != now and name not in UNSAID:
        yield f"{name} was {shorten(str(before), 80)}, now {shorten(str(now), 80)}"


def _by_name(value: Any) -> Any:
    """A list of objects, such as a scene's sensors, as a dictionary by their names or places."""
    if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
        return value
    return {item.get("name", str(place)): item for place, item in enumerate(value)}


def restored(value: T, stored: Any) -> T:
    """A configuration with the numbers, texts and sequences that were `described` of another one.

    What only one of the two has stays as it is, and so do functions. Raises RenetError where a
    dataclass refuses a value.
    """
    result: Any = value
    if isinstance(value, Enum):
        return value
    if isinstance(stored, dict) and isinstance(value, dict):
        result = {k: restored(v, stored[k]) if k in stored else v for k, v in value.items()}
    elif isinstance(stored, dict) and is_dataclass(value) and not isinstance(value, type):
        names = [f.name for f in fields(value) if f.init and f.name in stored]
        changes = {name: restored(getattr(value, name), stored[name]) for name in names}
        result = replace(value, **changes)
    elif isinstance(stored, list) and isinstance(value, list | tuple):
        if not any(map(is_dataclass, value)):
            result = type(value)(map(to_tuples, stored))
        elif len(stored) == len(value):
            result = type(value)(map(restored, value, stored))
    elif (isinstance(value, PLAIN) and (stored is None or isinstance(stored, PLAIN))) or (
        value is None and isinstance(stored, bool | int | float)
    ):
        result = stored
    return result
