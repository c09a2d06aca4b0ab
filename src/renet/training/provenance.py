"""Configurations as JSON in checkpoints, and their restoration from there."""

import json
import math
from collections.abc import Iterator
from dataclasses import fields, is_dataclass, replace
from enum import Enum
from fnmatch import fnmatchcase
from pathlib import Path
from textwrap import shorten
from typing import Any, TypeVar

from renet.errors import RenetError
from renet.tasks.env import RenetEnvCfg
from renet.tasks.schedule import value_at
from renet.training.config import RenetRunnerCfg

_T = TypeVar("_T")
PACKAGE = Path(__file__).parents[1]
"""Folder of the package, in which files of robots are."""
PLAIN = (bool, int, float, str)
"""Types of settings that JSON holds as they are."""
SILENT = ("env.seed", "agent.experiment_name")
"""Settings whose differences are reported elsewhere."""


def to_json(value: Any) -> Any:
    """Convert a configuration to a JSON value.

    Dataclasses become objects; functions and types become their names, and files of the package
    their paths in it.
    """

    def convert(item: Any) -> Any:
        if is_dataclass(item) and not isinstance(item, type):
            return {f.name: getattr(item, f.name) for f in fields(item)}
        if callable(item):
            # An object with `__call__` has no name of its own.
            name = getattr(item, "__qualname__", type(item).__name__)
            return f"{item.__module__}.{name}"
        if isinstance(item, Path) and item.is_relative_to(PACKAGE):
            # The same on all machines.
            return item.relative_to(PACKAGE.parent).as_posix()
        if isinstance(item, set):
            return list(item)
        return str(item)

    return json.loads(json.dumps(value, default=convert))


def to_tuples(value: Any) -> Any:
    """Convert lists of a JSON value, also nested ones, to tuples."""
    if isinstance(value, list):
        return tuple(map(to_tuples, value))
    return value


def differences(old: Any, new: Any, name: str) -> Iterator[str]:
    """Compare two JSON values, at all levels that both have.

    Args:
        old: Value of the run that is resumed.
        new: Value of the run that begins.
        name: Name of both, with dots between levels.

    Yields:
        A line for each difference.
    """
    old = by_name(old)
    new = by_name(new)
    if isinstance(old, dict) and isinstance(new, dict):
        for key in sorted(old.keys() | new.keys()):
            yield from differences(old.get(key, "absent"), new.get(key, "absent"), f"{name}.{key}")
    elif old != new and name not in SILENT:
        yield f"{name} was {shorten(str(old), 80)}, now {shorten(str(new), 80)}"


def by_name(value: Any) -> Any:
    """Convert a list of objects, such as a scene's sensors, to a dictionary.

    Keys are the objects' names, or their positions where they have none. Other values are returned
    as they are.
    """
    if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
        return value
    return {item.get("name", str(position)): item for position, item in enumerate(value)}


RESTORABLE = (
    "agent.adaptation",
    "agent.algorithm",
    "agent.average_over",
    "agent.batch_size",
    "agent.clip_actions",
    "agent.keep_checkpoints",
    "agent.max_iterations",
    "agent.model",
    "agent.num_steps_per_env",
    "agent.precision",
    "agent.save_interval",
    "agent.seed",
    "agent.supervision",
    "agent.withholding",
    "env.actions",
    "env.commands",
    "env.curriculum",
    "env.decimation",
    "env.episode_length_s",
    "env.events",
    "env.metrics",
    "env.motors",
    "env.observations",
    "env.rewards",
    "env.robot",
    "env.scene.entities",
    "env.scene.num_envs",
    "env.scene.sensors",
    "env.scene.terrain",
    "env.sim.mujoco.ccd_iterations",
    "env.sim.mujoco.cone",
    "env.sim.mujoco.impratio",
    "env.sim.mujoco.integrator",
    "env.sim.mujoco.iterations",
    "env.sim.mujoco.jacobian",
    "env.sim.mujoco.ls_iterations",
    "env.sim.mujoco.ls_tolerance",
    "env.sim.mujoco.solver",
    "env.sim.mujoco.timestep",
    "env.sim.mujoco.tolerance",
    "env.sim.nconmax",
    "env.sim.njmax",
    "env.terminations",
)
"""Settings, and groups of them, that a resumed run restores from its checkpoint: those that shape
the policy. All others, such as folders to write to, come from the command line alone, because the
checkpoint may come from a stranger."""
CONFIGURATIONS = {"agent": RenetRunnerCfg, "env": RenetEnvCfg}
"""Classes of both configurations, whose fields RESTORABLE names."""
BOUNDS = {
    "env.actions.*.target_rate": (0.0, math.inf),
    "env.decimation": (1, 100),
    "env.episode_length_s": (0.1, 3600),
    "env.scene.num_envs": (1, 2**17),
    "env.scene.sensors.*.height": (1, 1024),
    "env.scene.sensors.*.width": (1, 1024),
    "env.scene.terrain.terrain_generator.border_width": (0, 1000),
    "env.scene.terrain.terrain_generator.num_cols": (1, 100),
    "env.scene.terrain.terrain_generator.num_rows": (1, 100),
    "env.scene.terrain.terrain_generator.sub_terrains.*.count": (0, 1000),
    "env.scene.terrain.terrain_generator.sub_terrains.*.steps": (0, 100),
    "env.sim.mujoco.*iterations": (1, 1000),
    "env.sim.mujoco.timestep": (1e-4, 0.05),
    "env.sim.nconmax": (1, 100_000),
    "env.sim.njmax": (1, 100_000),
    "agent.keep_checkpoints": (1, 10_000),
    "agent.model.*": (-1e4, 1e4),
    "agent.num_steps_per_env": (1, 100_000),
    "*": (-1e10, 1e10),
}
"""Smallest and largest restored number of a setting, by the first pattern that matches its name."""


def restore(value: _T, stored: Any, name: str) -> _T:
    """Copy a configuration, with the settings of a stored one.

    Settings that only one of the two has stay as they are, and so do functions and settings that
    are not RESTORABLE.

    Args:
        value: The configuration.
        stored: JSON value of the other one (see `to_json`).
        name: Name of the value, with dots between levels, such as `env.rewards`.

    Raises:
        RenetError: A dataclass refuses a value, or a number is out of BOUNDS.
    """
    if isinstance(value, Enum):
        return value
    # Levels that both have are restored setting by setting; what does not match stays as it is.
    result: Any = value
    if isinstance(stored, dict) and isinstance(value, dict):
        result = dict(value)
        for key, item in value.items():
            if key in stored:
                result[key] = restore(item, stored[key], f"{name}.{key}")
    elif isinstance(stored, dict) and is_dataclass(value) and not isinstance(value, type):
        changes = {}
        for field in fields(value):
            if field.init and field.name in stored:
                item = getattr(value, field.name)
                path = f"{name}.{field.name}"
                changes[field.name] = restore(item, stored[field.name], path)
        result = replace(value, **changes)
    elif isinstance(stored, list) and isinstance(value, list | tuple):
        result = _restore_sequence(value, stored, name)
    elif value is None:
        if _can_be_set(stored) and is_allowed(stored, name):
            result = to_tuples(stored)
    elif _is_plain(value, stored) and is_allowed(stored, name):
        result = stored
    return result


def _restore_sequence(value: Any, stored: list[Any], name: str) -> Any:
    """Copy a list or tuple, with the settings of a stored one (see `restore`)."""
    # Plain items are restored together, and may be more or fewer than before.
    if not any(map(is_dataclass, value)):
        # Of an empty one nobody knows: a stored group of settings is none of its items.
        if is_allowed(stored, name) and not any(isinstance(item, dict) for item in stored):
            return type(value)(map(to_tuples, stored))
        return value
    # Dataclasses are restored one by one, if there are as many.
    if len(stored) != len(value):
        return value
    items = []
    for position, (item, stored_item) in enumerate(zip(value, stored, strict=True)):
        items.append(restore(item, stored_item, f"{name}.{position}"))
    return type(value)(items)


def _can_be_set(stored: Any) -> bool:
    """Return True if a setting that is None may take a stored value.

    These are numbers, lists of them, and schedules. Any other text may be a path.
    """
    if isinstance(stored, str):
        try:
            value_at(stored, 0.0)
        except RenetError:
            return False
        return True
    items = stored if isinstance(stored, list) else [stored]
    return all(isinstance(item, bool | int | float) for item in items)


def _is_plain(value: Any, stored: Any) -> bool:
    """Return True if a setting and its stored value are plain: numbers, texts, or None."""
    return isinstance(value, PLAIN) and (stored is None or isinstance(stored, PLAIN))


def is_allowed(stored: Any, name: str) -> bool:
    """Return True if a checkpoint's setting may be restored.

    Args:
        stored: The stored value.
        name: Name of the setting, with dots between levels.

    Raises:
        RenetError: A number is out of BOUNDS.
    """
    part, _, rest = name.partition(".")
    setting = rest.partition(".")[0]
    # Settings that somebody's own task or agent adds to ours shape the policy, too.
    is_addition = False
    if part in CONFIGURATIONS:
        is_addition = setting not in {field.name for field in fields(CONFIGURATIONS[part])}
    is_listed = any(name == known or name.startswith(f"{known}.") for known in RESTORABLE)
    if not is_addition and not is_listed:
        return False
    low, high = next(bounds for pattern, bounds in BOUNDS.items() if fnmatchcase(name, pattern))
    for number in _numbers(stored):
        if not low <= number <= high:
            raise RenetError(
                f"the checkpoint's setting {name} is {number:g}, which must be from {low:g} to "
                f"{high:g}: give --{name.replace('_', '-')} on the command line of a new run"
            )
    return True


def _numbers(value: Any) -> Iterator[float]:
    """Yield all numbers of a JSON value, at all levels."""
    if isinstance(value, list | tuple):
        for item in value:
            yield from _numbers(item)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield value
