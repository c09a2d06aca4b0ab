"""Films of robots side by side, each with its depth image, VP's map of the ground and its state."""

import re
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path

import mediapy
import mujoco
import numpy as np
from PIL import Image, ImageDraw, ImageFont
from scipy.spatial.transform import Rotation

from renet.errors import RenetError
from renet.evaluation.painter import Painter, View
from renet.evaluation.trace import Trace
from renet.files import write_atomically
from renet.interface import CONTROL_DT, HEIGHT_MAP_X, HEIGHT_MAP_Y, STEPS_PER_TICK
from renet.palette import STATES, UNSEEN_AHEAD, UNSEEN_COLOUR, ink, rgb
from renet.terminal import progress

_font = ImageFont.load_default
"""Pillow's own font: the same everywhere, nothing to install."""
_GREEN = (126, 200, 120)
_RED = (235, 92, 80)
_WHITE = (245, 245, 245)
DARK_GREEN = (30, 110, 50)
"""Background of the outcome "crossed"."""
DARK_RED = (170, 30, 25)
"""Background of the outcome "fell"."""
_NIGHT = (16, 18, 22)
"""Colour that dims the picture of a robot that fell."""
_DIMMED = 0.6
"""Share of that colour."""
_SHADE = (*_NIGHT, 190)
"""Background of texts, RGBA."""
_BAR = 30
"""Height of the bars above and below a picture, pixels."""
_CHIP = 116
"""Width of the state in the upper bar, pixels."""
_TEXT = 20
"""Size of the bars' texts, legible at half of the film's size, pixels."""
_CAMERA_SHARE = 0.57
"""Share of the lower bar for the camera; the rest is for distance and speed."""
_FPS = 25
"""Pictures per second, a divisor of the control rate."""
_DOT = 0.025
"""Radius of a height map's dots, m."""
_BLACK_ERROR = 0.25
"""Error of a height map from which on its dots are black, m."""


def film(path: Path, frames: Iterator[np.ndarray]) -> Path:
    """Write an mp4 that any browser plays, and return its path.

    Args:
        path: Path of the mp4.
        frames: Pictures, [height, width, 3] uint8 each, which are drawn one by one.

    Raises:
        RenetError: Ffmpeg is missing, or the file cannot be written.
    """
    try:
        video = mediapy.compress_video(frames, fps=_FPS, crf=26)
    # A pipe to an ffmpeg that has ended is broken.
    except (RuntimeError, BrokenPipeError) as error:
        if isinstance(error.__context__, KeyboardInterrupt):
            # ffmpeg, which a signal may end, too, has no more to say.
            raise KeyboardInterrupt(f"the film {path} is not written") from error
        raise RenetError(f"cannot write {path}: {_reason(error)}") from error
    write_atomically(path, video)
    return path


def _reason(error: Exception) -> str:
    """Return the first line of ffmpeg's own words in an error, without the temporary file."""
    text = re.sub(r"^Error writing '.*?': ?", "", str(error)).strip()
    return text.splitlines()[0] if text else "ffmpeg ended before the film did"


def pictures(
    spec: mujoco.MjSpec,
    trace: Trace,
    titles: Mapping[int, str],
    fault: str,
    steps: Sequence[int] = (),
    goal: float = np.inf,
) -> Iterator[np.ndarray]:
    """Draw robots side by side, with progress shown; yields pictures [height, width, 3] uint8.

    A robot whose first try is over is put back at its start by the simulator: its picture stops,
    and is dimmed if it fell.

    Args:
        spec: The scene.
        trace: A run whose robots are all on its film.
        titles: Titles of the robots to show, by their places in the trace.
        fault: Text for a failing camera.
        steps: Control steps of the pictures; by default the whole run in real time.
        goal: Distance from the start at which a robot has crossed, m.
    """
    assert trace.film is not None
    poses = trace.film.poses
    robots = list(titles)
    painter = Painter(spec, poses[0, robots])
    # Last step of each robot's first try.
    last = np.maximum((~trace.over).sum(axis=0) - 1, 0)
    steps = steps or range(0, len(poses), round(1 / (_FPS * CONTROL_DT)))
    for step in progress(steps, "video"):
        shown = {robot: min(step, last[robot]) for robot in robots}
        views = painter.draw(np.stack([poses[at, robot] for robot, at in shown.items()]))
        panels = []
        for view, (robot, at) in zip(views, shown.items(), strict=True):
            image = Image.fromarray(view.picture)
            _draw_map(image, view, painter, trace, at, robot)
            fell = bool(trace.fallen[step, robot])
            _stamp(image, trace, at, robot, titles[robot], fault, fell)
            if fell:
                _dim(image)
                _write_outcome(image, "fell", DARK_RED)
            elif trace.travelled[at, robot] >= goal:
                _write_outcome(image, "crossed", DARK_GREEN)
            panels.append(np.asarray(image))
        yield np.hstack(panels)


def _dim(image: Image.Image) -> None:
    """Dim a picture between its bars: its robot moves no more, and the others are to be watched."""
    box = (0, _BAR, image.width, image.height - _BAR)
    picture = image.crop(box)
    night = Image.new("RGB", picture.size, _NIGHT)
    image.paste(Image.blend(picture, night, _DIMMED), box)


def _write_outcome(image: Image.Image, outcome: str, colour: tuple[int, int, int]) -> None:
    """Write the end of a robot's try, large, and in place of its state."""
    draw = ImageDraw.Draw(image)
    draw.text((12, 36), outcome, colour, font=_font(44), stroke_width=2, stroke_fill=_WHITE)
    draw.rectangle((image.width - _CHIP, 0, image.width, _BAR), fill=colour)
    draw.text((image.width - 8, 3), outcome, font=_font(_TEXT), fill=_WHITE, anchor="ra")


def _state(trace: Trace, step: int, robot: int) -> str:
    """Return the name of a robot's state at a step: sees, remembers or blind."""
    if not trace.vision[step, robot]:
        return "blind"
    return "sees" if trace.has_image[step, robot] else "remembers"


def _draw_map(
    image: Image.Image, view: View, painter: Painter, trace: Trace, step: int, robot: int
) -> None:
    """Draw VP's map of the ground, as the web page does.

    Dots are in the state's colour, and darker up to black the more they are wrong. Those on ground
    that the robot has not seen have a colour of their own.
    """
    tick = step // STEPS_PER_TICK
    state = _state(trace, step, robot)
    film = trace.film
    if film is None or not film.maps.size or state == "blind":
        return
    # Points of the map in the world: the map turns with the robot's yaw alone.
    pose = film.poses[tick * STEPS_PER_TICK, robot]
    ahead, left = np.meshgrid(HEIGHT_MAP_X, HEIGHT_MAP_Y, indexing="ij")
    down = film.map_height + film.maps[tick, robot]
    grid = np.stack([ahead.ravel(), left.ravel(), -down], axis=1)
    yaw = Rotation.from_quat(pose[3:7], scalar_first=True).as_euler("ZYX")[:1]
    points = pose[:3] + Rotation.from_euler("z", yaw).apply(grid)
    error = np.abs(points[:, 2] - painter.heights(points)) / _BLACK_ERROR
    colours = np.array(rgb(STATES[state][0])) * (1 - np.clip(error, 0, 1))[:, None]
    colours[~film.maps_seen[tick, robot]] = rgb(UNSEEN_COLOUR)
    draw = ImageDraw.Draw(image)
    ground = view.ground
    for (x, y, scale), colour in zip(view.pixels(points), colours.astype(int), strict=True):
        column = int(x)
        row = int(y)
        size = _DOT * scale
        # A dot on the robot would hide it.
        inside = 0 <= row < ground.shape[0] and 0 <= column < ground.shape[1]
        if inside and ground[row, column]:
            draw.ellipse((x - size, y - 0.6 * size, x + size, y + 0.6 * size), tuple(colour))


def _stamp(
    image: Image.Image,
    trace: Trace,
    step: int,
    robot: int,
    title: str,
    fault: str,
    fell: bool,
) -> None:
    """Draw texts and the robot's depth image on a picture; a robot that fell has no speed."""
    assert trace.film is not None
    failing = trace.failing[step, robot]
    draw = ImageDraw.Draw(image, "RGBA")
    width, height = image.size
    state = _state(trace, step, robot)
    colour = rgb(STATES[state][0])
    # Upper bar: title and state.
    draw.rectangle((0, 0, width, _BAR), fill=_SHADE)
    draw.text((8, 3), title, font=_font(_TEXT), fill=_WHITE)
    draw.rectangle((width - _CHIP, 0, width, _BAR), fill=colour)
    draw.text((width - 8, 3), state, ink(STATES[state][0]), font=_font(_TEXT), anchor="ra")
    # Below it on the left: the robot walks towards ground that it has not seen.
    if trace.unseen[step, robot]:
        top = height - 2 * _BAR
        draw.rectangle((0, top, 150, top + _BAR), fill=UNSEEN_COLOUR)
        draw.text((8, top + 3), UNSEEN_AHEAD, ink(UNSEEN_COLOUR), font=_font(_TEXT))
    # Depth image with a frame that is red while the camera fails.
    depth = Image.fromarray(trace.film.images[step // STEPS_PER_TICK, robot])
    camera, camera_colour = (fault, _RED) if failing else ("camera healthy", _GREEN)
    draw.rectangle((width - 106, 38, width - 7, 113), fill=camera_colour)
    image.paste(depth.resize((96, 72), Image.Resampling.NEAREST), (width - 104, 40))
    # Lower bar: distance, speed and camera.
    draw.rectangle((0, height - _BAR, width, height), fill=_SHADE)
    pace = f"{trace.travelled[step, robot]:.1f} m"
    if not fell:
        pace += f", {trace.speed[step, robot]:.1f} m/s"
    draw.text((8, height - _BAR + 3), pace, font=_font(_TEXT), fill=_WHITE)
    # The names of several faults are as small as they must be beside distance and speed.
    size = _fitting_size(camera, _CAMERA_SHARE * width)
    place = (width - 8, height - _BAR + 3 + (_TEXT - size) / 2)
    draw.text(place, camera, font=_font(size), fill=camera_colour, anchor="ra")


@cache
def _fitting_size(text: str, room: float) -> int:
    """Return the size of a bar's text, smaller if it is too long for `room`; both in pixels."""
    size = _TEXT
    while size > 1 and _font(size).getlength(text) > room:
        size -= 1
    return size
