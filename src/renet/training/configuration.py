"""`renet train --config FILE`: what a run wrote in its config.json, or any part of it, given back.

The file is the user's own: unlike a checkpoint it may set whatever the command line may. What the
task does not know is an error, so that a misspelt setting is never passed over.
"""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

from typeguard import TypeCheckError, check_type

from renet.errors import RenetError, unknown_name
from renet.options import TrainOptions
from renet.terrain.own_ground import KIND
from renet.training.config import to_tuples
from renet.training.provenance import PLAIN, to_json

T = TypeVar("T")
PARTS = ("agent", "env")
"""The task's configurations in a file."""
IGNORED = ("task", "code", *PARTS)
"""Keys of a file that are no option of the command line's."""
UNSET = ("task", "resume", "config")
"""Options that a file cannot set."""


def task_of(settings: Mapping[str, Any], path: Path, asked: str) -> str:
    """The task of a run with these settings, by default the file's; raises RenetError for two."""
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
    """What a file sets of the options that are no settings of a task, such as num_envs.

    Raises RenetError for names and values that are no option's.
    """
    hints = get_type_hints(TrainOptions)
    known = [field.name for field in fields(TrainOptions) if field.name not in UNSET]
    options = own_ground_of(settings)
    for name, value in settings.items():
        if name in IGNORED:
            continue
        if name not in known:
            raise unknown_name("setting", str(name), [*IGNORED, *known])
        if hints[name] == Path | None and isinstance(value, str):
            value = Path(value)
        options[name] = _checked(value, hints[name], f"{path}: {name}")
    return options


def own_ground_of(settings: Mapping[str, Any]) -> dict[str, Any]:
    """The options for the own ground that a run wrote among its tiles; none where it had none."""
    tiles: Any = settings
    for name in ("env", "scene", "terrain", "terrain_generator", "sub_terrains"):
        tiles = tiles.get(name) if isinstance(tiles, Mapping) else None
    if not isinstance(tiles, Mapping) or KIND not in tiles:
        return {}
    try:
        source = tiles[KIND]["source"]
        total = sum(tile["proportion"] for tile in tiles.values())
        return {
            "scene": Path(source["file"]),
            "scene_width": float(source["width"]),
            "scene_height": float(source["height"]),
            "scene_share": tiles[KIND]["proportion"] / total,
        }
    except (KeyError, TypeError, ValueError, ZeroDivisionError) as error:
        raise RenetError(
            f"the configuration's own ground is incomplete ({error}): say --scene instead"
        ) from error


def configured(value: T, stored: Any, name: str) -> T:
    """A configuration with what a file says of it.

    Args:
        value: the configuration. stored: the file's values, by name, of any of its settings.
        name: of the value, with dots between levels, such as `env.rewards`.

    Raises:
        RenetError: a setting that there is not, or a value that it cannot have.
    """
    if stored == to_json(value):  # As a run wrote it, functions too.
        return value
    result: Any
    if is_dataclass(value) and not isinstance(value, type):
        result = _configured_dataclass(value, stored, name)
    elif isinstance(value, dict):
        _demand_names(stored, list(value), name)
        changes = {
            key: configured(value[key], item, f"{name}.{key}") for key, item in stored.items()
        }
        result = {**value, **changes}
    elif isinstance(value, list | tuple) and any(map(is_dataclass, value)):
        result = _configured_items(value, stored, name)
    else:
        result = _leaf(value, stored, name)
    return result


def _configured_dataclass(value: Any, stored: Any, name: str) -> Any:
    """A dataclass with a file's values, each of the type that its field has."""
    settable = [field.name for field in fields(value) if field.init]
    _demand_names(stored, settable, name)
    try:
        hints = get_type_hints(type(value))
    except NameError:  # Some of mjlab's types are imported for type checkers alone.
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
    """A sequence of dataclasses, such as a scene's sensors, all of which a file must list."""
    if not isinstance(stored, list) or len(stored) != len(value):
        raise RenetError(f"{name} must list {len(value)} items, as `renet recipe` prints them")
    items = zip(value, stored, strict=True)
    return type(value)(configured(*pair, f"{name}.{place}") for place, pair in enumerate(items))


def _leaf(value: Any, stored: Any, name: str) -> Any:
    """A number, a text or a sequence of them in place of another one."""
    if isinstance(value, Path):
        return Path(_checked(stored, str, name))
    if value is None or isinstance(value, PLAIN):
        return stored
    if isinstance(value, list | tuple | set) and isinstance(stored, list):
        return type(value)(map(to_tuples, stored))
    raise RenetError(
        f"{name} cannot be changed in a file: it is {to_json(value)!r} in this task. Take it out,"
        " or register a task of your own"
    )


def _demand_names(stored: Any, known: list[str], name: str) -> None:
    """Raise RenetError unless a file's value maps names that there are."""
    if not isinstance(stored, dict):
        raise RenetError(f"{name} must map names to values, got {stored!r}")
    for key in stored:
        if key not in known:
            raise unknown_name("setting", f"{name}.{key}", [f"{name}.{other}" for other in known])


def _checked(value: Any, hint: Any, name: str) -> Any:
    """A value if it is of a type; raises RenetError."""
    try:
        return check_type(value, hint)
    except TypeCheckError as error:
        raise RenetError(f"{name} cannot be {value!r}: {str(error).splitlines()[0]}") from error
