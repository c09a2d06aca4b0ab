"""Film of the long walk: two robots side by side on the sections that tell modes apart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path

import mujoco
import numpy as np
from PIL import Image

from renet.errors import RenetError
from renet.evaluation.trace import Film, Trace
from renet.evaluation.video import pictures
from renet.files import write_atomically
from renet.interface import STEPS_PER_TICK, control_steps

SHOWN = ("covered lens, stairs", "gaps in a row", "platform of 48 cm", "covered lens, gap")
"""Sections that the film shows, one after the other."""
_FPS = 10
"""Pictures per second."""
_PACE = 2
"""Simulated seconds in a second of film."""
_LAST = 1.0
"""Time for which the end of a section stays, s of simulated time."""
_PATIENCE = 6.0
"""Longest time for which the film waits for the slower robot, s of simulated time."""
_QUALITY = 35
"""Of the WebP, 0 to 100."""
_STATES = ("vision", "has_image", "unseen", "failing", "forward_velocity")
"""What the pictures show of each control step."""


@dataclass(frozen=True)
class Visit:
    """Robots on their way along a lap, after each of T control steps; see `LapEnv`."""

    trace: Trace
    """With a film of all N robots."""
    section: np.ndarray
    """Section of each robot, [T, N]."""
    position: np.ndarray
    """Position along the lap, [T, N] m."""
    finished: np.ndarray
    """True at the end of the lap, [T, N] bool."""

    def steps(self, number: int, robot: int) -> np.ndarray:
        """Control steps that a robot spends in a section, from a vision tick on."""
        inside = (self.section[:, robot] == number) & ~self.finished[:, robot]
        # It is in the section after the first of these, and leaves it in the step after the last.
        within = np.flatnonzero(inside)
        if not len(within):
            raise RenetError("a robot of the film has not come to its sections: walk a whole lap")
        first = -(-(within[0] + 1) // STEPS_PER_TICK) * STEPS_PER_TICK
        last = min(within[-1] + 1, len(inside) - 1)
        return np.arange(first, last + 1)


def pair(ends: np.ndarray) -> int:
    """Number of the first robot that shows the largest difference between two modes.

    Args:
        ends: how each section of the film ended for each robot, [modes, robots, sections].
    """
    first = ends[0] == "crossed"
    last = ends[-1] == "crossed"
    return int((first & ~last).sum(axis=1).argmax())


def clip(visit: Visit, number: int, robots: Sequence[int], start: float) -> Trace:
    """Cut two robots' ways through a section, each from its own beginning on.

    Args:
        visit: the whole walk.
        number: the section.
        robots: places of the robots in the trace.
        start: where the section begins, m.
    """
    trace = visit.trace
    assert trace.film is not None
    ways = [visit.steps(number, robot) for robot in robots]
    sooner, later = sorted(map(len, ways))
    count = min(later, sooner + control_steps(_PATIENCE)) + control_steps(_LAST)
    shown = []
    for way in ways:
        # Whoever is through sooner stays in its last picture.
        shown.append(np.pad(way[:count], (0, max(count - len(way), 0)), mode="edge"))
    steps = np.stack(shown, axis=1)
    cut = Trace.empty(count, len(robots))
    for name in _STATES:
        getattr(cut, name)[:] = getattr(trace, name)[steps, robots]
    cut.travelled[:] = visit.position[steps, robots] - start
    for place, (way, robot) in enumerate(zip(ways, robots, strict=True)):
        end = len(way) - 1
        if end >= count:
            continue
        cut.ended[end, place] = True
        cut.fell[end, place] = trace.fell[way[-1], robot]
        # A robot that fell is at its next start already.
        cut.travelled[end:, place] = cut.travelled[max(end - 1, 0), place]
    ticks = steps[::STEPS_PER_TICK] // STEPS_PER_TICK
    of = trace.film
    maps = of.maps[ticks, robots], of.maps_seen[ticks, robots]
    poses = of.poses[steps, robots]
    return replace(cut, film=Film(poses, of.images[ticks, robots], *maps, of.map_height))


def write(
    path: Path,
    spec: mujoco.MjSpec,
    visit: Visit,
    robots: Mapping[str, int],
    sections: Mapping[str, int],
    starts: np.ndarray,
) -> Path:
    """Film two robots, an animated WebP.

    Args:
        path: path of the film.
        spec: the scene.
        visit: the walk.
        robots: place in the trace of each mode's robot.
        sections: number of each section by its name.
        starts: where sections begin, and where the last one ends, m.
    """
    images = []
    pace = control_steps(_PACE / _FPS)
    for name in SHOWN:
        number = sections[name]
        cut = clip(visit, number, list(robots.values()), starts[number])
        titles = {place: f"{mode}: {name}" for place, mode in enumerate(robots)}
        # The last position is that of a step before the section's end.
        length = starts[number + 1] - starts[number] - 0.05
        steps = range(0, len(cut.fell), pace)
        for picture in pictures(spec, cut, titles, "covered", steps, length):
            images.append(Image.fromarray(picture))
    options = {"duration": 1000 // _FPS, "loop": 0, "quality": _QUALITY, "method": 6}
    content = BytesIO()
    images[0].save(content, "webp", save_all=True, append_images=images[1:], **options)
    write_atomically(path, content.getvalue())
    return path
