"""Limits of VP's memory of the ground, from a comparison with OP: `renet calibrate`."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from renet.evaluation.rollout import Rollout, Trial, pilot_modes, robot_numbers
from renet.faults import Injection
from renet.interface import CONTROL_DT, control_steps
from renet.pilot import Pilot
from renet.selector import make_selector
from renet.selector.calibration import stale_above
from renet.selector.selector import LONGEST_MEMORY

if TYPE_CHECKING:
    from renet.evaluation.evaluator import Evaluator
    from renet.evaluation.trace import Trace

MEMORY = "map_error"
"""The monitor of VP's memory."""
Memory = tuple[dict[str, float], float]
"""Threshold of that monitor, if there is one, and the longest time without an image, s."""
BLACKOUT_RANGE = (0.5, 3.0)
"""Range of the times after the start at which cameras go black for good, s."""
MEASURED_TIME = 10.0
"""Time without an image that is simulated, s: a robot that walks so long has left its tile."""
_WARNING_TIME = 0.5
"""Time before a fall at which the memory that led to it is judged, s."""


def memory_limits(
    evaluator: Evaluator, robots: int, levels: int, speed: float, seed: int
) -> Memory:
    """Measure limits of memory: a predicted error of the map, and a time without an image.

    Beyond a limit OP falls less often than VP does from memory. Robots whose cameras die walk in
    mode memory, their twins in mode blind, in one try on every kind and level of tile, in nominal
    conditions. If OP is never better, there is no threshold, and memory may last as long as was
    measured.

    Args:
        evaluator: Evaluator of the bundle.
        robots: Number of robots.
        levels: Highest level, 1 to 10.
        speed: Commanded speed, m/s.
        seed: Seed of the robots and of the times at which cameras die.
    """
    # Only the runtime is needed to calibrate from recordings.
    from renet.tasks.parkour_env_cfg import parkour_env_cfg
    from renet.terrain.tiles import tiles

    numbers = np.arange(robots)
    earliest = control_steps(BLACKOUT_RANGE[0])
    latest = control_steps(BLACKOUT_RANGE[1])
    deaths = np.random.default_rng(seed).integers(earliest, latest, robots)
    trials = []
    for number, step in enumerate(deaths.tolist()):
        trials.append(Trial("memory", (Injection.of("blackout", 5, step),), number))
    trials += [Trial("blind", (), number) for number in range(robots)]
    task = parkour_env_cfg(play=True, robot=evaluator.robot)
    env = evaluator.make_env(task, robot_numbers(trials), speed, seed)
    # All kinds of tile at a level, then those at the next one.
    kinds = numbers % len(tiles())
    level = numbers // len(tiles()) % levels
    env.place(np.tile(level, 2), np.tile(kinds, 2))
    # Memory has no limits of its own in this run; the other monitors judge as ever.
    spec = evaluator.bundle.manifest.selector
    others = dict(spec.thresholds)
    others.pop(MEMORY, None)
    endless = replace(spec, thresholds=others, longest_memory=LONGEST_MEMORY)
    selectors = {"memory": make_selector("memory", endless, len(trials))}
    pilot = Pilot(evaluator.make_policy(len(trials)), selectors, pilot_modes(trials))
    rollout = Rollout(env, pilot, trials, seed)
    steps = latest + control_steps(MEASURED_TIME)
    trace = rollout.run(steps, "memory", until_ended=0, retire=True)
    # Two levels of a kind are one ground.
    return limits_of_trace(trace, deaths, kinds * levels + level // 2)


def limits_of_trace(trace: Trace, deaths: np.ndarray, ground: np.ndarray) -> Memory:
    """Compute the limits of memory from a run.

    Args:
        trace: Trace of N robots in mode memory, then of their N twins in mode blind.
        deaths: Control step at which each camera dies, [N].
        ground: Number of each robot's ground, [N].
    """
    count = len(deaths)
    steps = np.arange(len(trace.over))[:, None]
    walks = trace.trying
    falls = walks & trace.fell
    blackout = steps >= deaths
    # Falls per step in mode blind on each ground, after the time at which the twin's camera dies.
    blind_walks = np.bincount(ground, (blackout & walks[:, count:]).sum(axis=0))
    blind_falls = np.bincount(ground, (blackout & falls[:, count:]).sum(axis=0))
    rate = blind_falls / np.maximum(blind_walks, 1)
    # The steps of robots in mode memory without an image, flat: [M].
    moments = blackout & walks[:, :count]
    expected = np.broadcast_to(rate[ground], moments.shape)[moments]
    fell = falls[:, :count][moments]
    # The map's predicted error some time before each step.
    earlier = control_steps(_WARNING_TIME)
    error = np.vstack([trace.map_error[:1, :count].repeat(earlier, 0), trace.map_error[:, :count]])
    limit = stale_above(error[: len(steps)][moments], fell, expected)
    without = np.broadcast_to((steps - deaths) * CONTROL_DT, moments.shape)[moments]
    longest = min(stale_above(without, fell, expected), MEASURED_TIME)
    thresholds = {MEMORY: limit} if np.isfinite(limit) else {}
    return thresholds, longest
