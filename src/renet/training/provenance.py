"""What a checkpoint says of its run: both configurations as JSON, and the way back from there."""

import json
from collections.abc import Iterator
from dataclasses import fields, is_dataclass, replace
from enum import Enum
from fnmatch import fnmatchcase
from textwrap import shorten
from typing import Any, TypeVar

from renet.errors import RenetError
from renet.tasks.env import RenetEnvCfg
from renet.training.config import RenetRunnerCfg, to_tuples

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


ALLOWED = (
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
"""Settings, and groups of them, that a run takes over from a checkpoint it resumes: what shapes the
policy. Where files are written, who is called and what is drawn is the command line's alone, for a
checkpoint may be a stranger's."""
OURS = {"agent": RenetRunnerCfg, "env": RenetEnvCfg}
"""Classes of both configurations, whose fields ALLOWED is about."""
BOUNDS = {
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
"""Smallest and largest values of numbers that are taken over, by the first pattern that fits."""


def restored(value: T, stored: Any, name: str) -> T:
    """A configuration with the numbers, texts and sequences that were `described` of another one.

    What only one of the two has stays as it is, and so do functions and whatever is not ALLOWED.

    Args:
        value: the configuration. stored: the other one's description.
        name: of the value, with dots between levels, such as `env.rewards`.

    Raises:
        RenetError: a dataclass refuses a value, or a number is out of BOUNDS.
    """
    if isinstance(value, Enum):
        return value
    result: Any = value
    if isinstance(stored, dict) and isinstance(value, dict):
        result = {
            key: restored(item, stored[key], f"{name}.{key}") if key in stored else item
            for key, item in value.items()
        }
    elif isinstance(stored, dict) and is_dataclass(value) and not isinstance(value, type):
        names = [f.name for f in fields(value) if f.init and f.name in stored]
        changes = {
            key: restored(getattr(value, key), stored[key], f"{name}.{key}") for key in names
        }
        result = replace(value, **changes)
    elif isinstance(stored, list) and isinstance(value, list | tuple):
        if not any(map(is_dataclass, value)):
            result = type(value)(map(to_tuples, stored)) if allowed(stored, name) else value
        elif len(stored) == len(value):
            pairs = zip(value, stored, strict=True)
            items = (restored(*pair, f"{name}.{place}") for place, pair in enumerate(pairs))
            result = type(value)(items)
    elif (isinstance(value, PLAIN) and (stored is None or isinstance(stored, PLAIN))) or (
        value is None and isinstance(stored, bool | int | float)
    ):
        result = stored if allowed(stored, name) else value
    return result


def allowed(stored: Any, name: str) -> bool:
    """Whether a checkpoint's setting is taken over; raises RenetError if it is out of bounds."""
    part, _, rest = name.partition(".")
    setting = rest.partition(".")[0]
    # What a task or an agent of another's adds of its own shapes the policy, too.
    added = part in OURS and setting not in {f.name for f in fields(OURS[part])}
    listed = any(name == known or name.startswith(f"{known}.") for known in ALLOWED)
    if not added and not listed:
        return False
    low, high = next(bounds for pattern, bounds in BOUNDS.items() if fnmatchcase(name, pattern))
    for number in numbers(stored):
        if not low <= number <= high:
            raise RenetError(
                f"the checkpoint's setting {name} is {number:g}, which must be from {low:g} to "
                f"{high:g}: give --{name.replace('_', '-')} on the command line of a new run"
            )
    return True


def numbers(value: Any) -> Iterator[float]:
    """All numbers of a JSON value, as deep as they are."""
    if isinstance(value, list | tuple):
        for item in value:
            yield from numbers(item)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield value
