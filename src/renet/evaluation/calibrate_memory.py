"""How stale VP's memory of the ground may be: `renet calibrate` compares it with OP."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from renet.evaluation.rollout import Rollout, Trial, pilot_modes
from renet.faults import Injection
from renet.interface import CONTROL_DT
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
"""Its threshold, if there is one, and the longest time without an image, s."""
DIES = 0.5, 3.0
"""Between these times after its start, s, each robot's camera goes black for good."""
MEASURED = 10.0
"""Seconds without an image that are simulated: who has gone so far has left its tile."""
WARNED = 0.5
"""Seconds before a fall at which the memory that led to it is judged."""


def memory_limits(
    evaluator: Evaluator, robots: int, levels: int, speed: float, seed: int
) -> Memory:
    """Limits of memory: an expected error of the map, and seconds without an image.

    From there on OP falls less often. Robots whose cameras die walk from memory, their twins with
    OP all the while, in one try on every kind and level of tile. Where OP is never better, there is
    no threshold, and memory may last as long as was measured.

    Args:
        evaluator: of the bundle. robots: number of robots. levels: highest level, 1 to 10.
        speed: commanded, m/s. seed: of the robots and of when cameras die.
    """
    # Only the runtime is needed to calibrate from recordings.
    from renet.tasks.parkour_env_cfg import parkour_env_cfg
    from renet.terrain.tiles import tiles

    numbers = np.arange(robots)
    earliest, latest = (round(seconds / CONTROL_DT) for seconds in DIES)
    dies = np.random.default_rng(seed).integers(earliest, latest, robots)
    blackouts = [(Injection.of("blackout", 5, int(step)),) for step in dies]
    trials = [Trial("memory", blackouts[n], n) for n in numbers.tolist()]
    trials += [Trial("blind", (), n) for n in numbers.tolist()]
    task = parkour_env_cfg(play=True, robot=evaluator.robot)
    env = evaluator.make_env(task, [trial.robot for trial in trials], speed, seed)
    kinds, level = numbers % len(tiles()), numbers // len(tiles()) % levels
    env.place(np.tile(level, 2), np.tile(kinds, 2))
    spec = evaluator.bundle.manifest.selector
    others = {name: limit for name, limit in spec.thresholds.items() if name != MEMORY}
    endless = replace(spec, thresholds=others, longest_memory=LONGEST_MEMORY)
    selectors = {"memory": make_selector("memory", endless, len(trials))}
    pilot = Pilot(evaluator.make_policy(len(trials)), selectors, pilot_modes(trials))
    rollout = Rollout(env, pilot, trials, seed)
    steps = latest + round(MEASURED / CONTROL_DT)
    trace = rollout.run(steps, "memory", until_ended=0, retire=True)
    # Two levels of a kind are one ground.
    return compare(trace, dies, kinds * levels + level // 2)


def compare(trace: Trace, dies: np.ndarray, ground: np.ndarray) -> Memory:
    """Limits from a run.

    Args:
        trace: of N robots that walk from memory, then of their N twins with OP.
        dies, ground: control step at which each camera dies, and number of its ground, [N].
    """
    steps, count = np.arange(len(trace.over))[:, None], len(dies)
    walks = np.vstack([np.ones((1, 2 * count), bool), ~trace.over[:-1]])
    falls = walks & trace.fell
    begun = steps >= dies
    blind_walks, blind_falls = (
        np.bincount(ground, (begun & values[:, count:]).sum(axis=0)) for values in (walks, falls)
    )
    rate = blind_falls / np.maximum(blind_walks, 1)
    moments = begun & walks[:, :count]
    expected = np.broadcast_to(rate[ground], moments.shape)[moments]
    fell = falls[:, :count][moments]
    earlier = round(WARNED / CONTROL_DT)
    error = np.vstack([trace.map_error[:1, :count].repeat(earlier, 0), trace.map_error[:, :count]])
    limit = stale_above(error[: len(steps)][moments], fell, expected)
    without = np.broadcast_to((steps - dies) * CONTROL_DT, moments.shape)[moments]
    longest = min(stale_above(without, fell, expected), MEASURED)
    return ({MEMORY: limit} if np.isfinite(limit) else {}), longest
