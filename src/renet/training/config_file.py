"""Settings of `renet train --config FILE`: a run's config.json, or any part of one.

The file is the user's own, so that, unlike a checkpoint, it may set all that the command line may.
A setting that the task lacks is an error, so that none is ignored because of a typing error.
"""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

from typeguard import TypeCheckError, check_type

from renet.errors import RenetError, unknown_name
from renet.interface import OWN_GROUND
from renet.options import TrainOptions
from renet.training.provenance import PLAIN, to_json, to_tuples

_T = TypeVar("_T")
PARTS = ("agent", "env")
"""The task's configurations in a file."""
NO_OPTIONS = ("task", "code", *PARTS)
"""Keys of a file that are no options of the command line."""
UNSET = ("task", "resume", "config")
"""Options that a file cannot set."""


def task_of(settings: Mapping[str, Any], path: Path, asked: str) -> str:
    """Return the id of the task to train.

    Args:
        settings: The file's settings.
        path: Path of the file, for messages.
        asked: Task on the command line, or an empty text for the file's.

    Raises:
        RenetError: File and command line name different tasks.
    """
    stored = settings.get("task", "")
    if not isinstance(stored, str):
        raise RenetError(f"{path}: task must be a text, got {stored!r}")
    if asked and stored and asked != stored:
        raise RenetError(
            f"{path} is of the task {stored}: train that, or take the file's `task` line, and what"
            f" {asked} has not, out of it"
        )
    return asked or stored


def options_of(settings: Mapping[str, Any], path: Path) -> dict[str, Any]:
    """Return the options in a file that do not belong to a task, such as num_envs.

    Args:
        settings: The file's settings.
        path: Path of the file, for messages.

    Raises:
        RenetError: A name is no option, or a value is of another type.
    """
    hints = get_type_hints(TrainOptions)
    known = [field.name for field in fields(TrainOptions) if field.name not in UNSET]
    # Options that the file states win over those of the ground among its tiles.
    options = own_ground_of(settings)
    for name, value in settings.items():
        if name in NO_OPTIONS:
            continue
        if name not in known:
            raise unknown_name("setting", str(name), [*NO_OPTIONS, *known])
        # JSON and YAML have no paths.
        if hints[name] == Path | None and isinstance(value, str):
            value = Path(value)
        options[name] = _checked(value, hints[name], f"{path}: {name}")
    return options


def own_ground_of(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options of the user's own ground among a configuration's tiles, if it has one.

    Raises:
        RenetError: Values of the ground are missing or of another type.
    """
    # Only options can build the tile again: the configuration has its source, not its heights.
    tiles: Any = settings
    for name in ("env", "scene", "terrain", "terrain_generator", "sub_terrains"):
        tiles = tiles.get(name) if isinstance(tiles, Mapping) else None
    if not isinstance(tiles, Mapping) or OWN_GROUND not in tiles:
        return {}
    try:
        source = tiles[OWN_GROUND]["source"]
        total = sum(tile["proportion"] for tile in tiles.values())
        return {
            "scene": Path(source["file"]),
            "scene_width": float(source["width"]),
            "scene_height": float(source["height"]),
            "scene_share": tiles[OWN_GROUND]["proportion"] / total,
        }
    except (KeyError, TypeError, ValueError, ZeroDivisionError) as error:
        raise RenetError(
            f"the configuration's own ground is incomplete ({error}): say --scene instead"
        ) from error


def configured(value: _T, stored: Any, name: str) -> _T:
    """Copy a configuration, with the settings of a file.

    Args:
        value: The configuration, or a setting of it at any level.
        stored: The file's value of it; an object need not have all settings.
        name: Name of the setting, with dots between levels, such as `env.rewards`.

    Raises:
        RenetError: The configuration has no such setting, or the setting no such value.
    """
    # Also functions, which a file cannot change, stay as a run wrote them.
    if stored == to_json(value):
        return value
    result: Any
    if is_dataclass(value) and not isinstance(value, type):
        result = _configured_dataclass(value, stored, name)
    elif isinstance(value, dict):
        _demand_names(stored, list(value), name)
        result = dict(value)
        for key, item in stored.items():
            result[key] = configured(value[key], item, f"{name}.{key}")
    elif isinstance(value, list | tuple) and any(map(is_dataclass, value)):
        result = _configured_items(value, stored, name)
    else:
        result = _leaf(value, stored, name)
    return result


def _configured_dataclass(value: Any, stored: Any, name: str) -> Any:
    """Copy a dataclass, with a file's values, which must be of the types of their fields."""
    settable = [field.name for field in fields(value) if field.init]
    _demand_names(stored, settable, name)
    try:
        hints = get_type_hints(type(value))
    except NameError:
        # Some of mjlab's types are imported for type checkers alone.
        hints = {}
    changes = {}
    for key, item in stored.items():
        before = getattr(value, key)
        after = configured(before, item, f"{name}.{key}")
        if after is not before:
            after = _checked(after, hints.get(key, Any), f"{name}.{key}")
        changes[key] = after
    return replace(value, **changes)


def _configured_items(value: Any, stored: Any, name: str) -> Any:
    """Copy a sequence of dataclasses, such as a scene's sensors; a file must list all of them."""
    if not isinstance(stored, list) or len(stored) != len(value):
        raise RenetError(f"{name} must list {len(value)} items, as `renet recipe` prints them")
    items = []
    for position, (item, stored_item) in enumerate(zip(value, stored, strict=True)):
        items.append(configured(item, stored_item, f"{name}.{position}"))
    return type(value)(items)


def _leaf(value: Any, stored: Any, name: str) -> Any:
    """Return the file's value of a number, a text or a sequence of them."""
    if isinstance(value, Path):
        return Path(_checked(stored, str, name))
    if value is None:
        return to_tuples(stored)
    if isinstance(value, PLAIN):
        return stored
    if isinstance(value, list | tuple | set) and isinstance(stored, list):
        return type(value)(map(to_tuples, stored))
    raise RenetError(
        f"{name} cannot be changed in a file: it is {to_json(value)!r} in this task. Take it out,"
        " or register a task of your own"
    )


def _demand_names(stored: Any, known: list[str], name: str) -> None:
    """Raise RenetError unless a file's value is an object whose names are all known."""
    if not isinstance(stored, dict):
        raise RenetError(f"{name} must map names to values, got {stored!r}")
    for key in stored:
        if key not in known:
            raise unknown_name("setting", f"{name}.{key}", [f"{name}.{other}" for other in known])


def _checked(value: Any, hint: Any, name: str) -> Any:
    """Return a value that is of the type `hint`; raises RenetError for any other."""
    try:
        return check_type(value, hint)
    except TypeCheckError as error:
        raise RenetError(f"{name} cannot be {value!r}: {str(error).splitlines()[0]}") from error
