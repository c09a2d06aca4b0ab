"""Films of robots side by side: what each sees, what ground it believes in, what becomes of it."""

from collections.abc import Iterator, Mapping, Sequence
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
from renet.interface import CONTROL_DT, HEIGHT_MAP_X, HEIGHT_MAP_Y, MAP_HEIGHT, STEPS_PER_TICK
from renet.palette import STATES, rgb
from renet.terminal import progress

_font = ImageFont.load_default
"""Pillow's own font: the same everywhere, nothing to install."""
GREEN = (126, 200, 120)
RED = (235, 92, 80)
WHITE = (245, 245, 245)
DARK_GREEN = (30, 110, 50)
DARK_RED = (170, 30, 25)
"""Of outcomes, which white text is read on."""
SHADE = (16, 18, 22, 190)
"""Behind texts."""
FPS = 25
"""Pictures a second, a divisor of the control rate."""
DOT, WRONG = 0.025, 0.25
"""Radius of a height map's dots, m, and the error from which on they are black."""


def film(
    path: Path,
    spec: mujoco.MjSpec,
    trace: Trace,
    titles: Mapping[int, str],
    fault: str,
    steps: Sequence[int] = (),
    goal: float = np.inf,
) -> Path:
    """Draw robots side by side and write an mp4 that any browser plays, beside a progress bar.

    A robot whose first try is over is put back at its start by the simulator: its picture stops.

    Args:
        path: of the mp4; raises RenetError if ffmpeg is missing, or it cannot be written.
        spec: the scene. trace: a run whose robots are all on its film.
        titles: what to call the robots that are shown, by their places in the trace.
        fault: what to call a failing camera.
        steps: control steps of the pictures; all of them, at the clock's pace, by default.
        goal: distance from its start from which on a robot has crossed, m.
    """
    poses, robots = trace.film.poses, list(titles)  # type: ignore[union-attr]
    painter = Painter(spec, poses[0, robots])
    last = np.maximum((~trace.over).sum(axis=0) - 1, 0)

    def pictures() -> Iterator[np.ndarray]:
        for step in progress(steps or range(0, len(poses), round(1 / (FPS * CONTROL_DT))), "video"):
            shown = {robot: min(step, last[robot]) for robot in robots}
            views = painter.draw(np.stack([poses[at, robot] for robot, at in shown.items()]))
            panels = []
            for view, (robot, at) in zip(views, shown.items(), strict=True):
                image = Image.fromarray(view.picture)
                _draw_map(image, view, painter, trace, at, robot)
                _stamp(image, trace, at, robot, titles[robot], fault)
                if trace.fallen[step, robot]:
                    _write_outcome(image, "fell", DARK_RED)
                elif trace.travelled[at, robot] >= goal:
                    _write_outcome(image, "crossed", DARK_GREEN)
                panels.append(np.asarray(image))
            yield np.hstack(panels)

    try:
        video = mediapy.compress_video(pictures(), fps=FPS, crf=26)
    except RuntimeError as error:
        raise RenetError(f"cannot write {path}: {str(error).splitlines()[0]}") from error
    write_atomically(path, video)
    return path


def _write_outcome(image: Image.Image, outcome: str, colour: tuple[int, int, int]) -> None:
    """Write how a robot's try ended, large, and in place of its state."""
    draw = ImageDraw.Draw(image)
    draw.text((12, 30), outcome, colour, font=_font(44), stroke_width=2, stroke_fill=WHITE)
    draw.rectangle((image.width - 92, 0, image.width, 24), fill=colour)
    draw.text((image.width - 8, 4), outcome, font=_font(14), fill=WHITE, anchor="ra")


def _state(trace: Trace, step: int, robot: int) -> str:
    """Name of a robot's state."""
    if not trace.vision[step, robot]:
        return "blind"
    return "sees" if trace.has_image[step, robot] else "remembers"


def _draw_map(
    image: Image.Image, view: View, painter: Painter, trace: Trace, step: int, robot: int
) -> None:
    """Draw VP's map of the ground, as the page does: in the state's colour, black where wrong."""
    tick, state = step // STEPS_PER_TICK, _state(trace, step, robot)
    film = trace.film
    if film is None or not film.maps.size or state == "blind":
        return
    pose = film.poses[tick * STEPS_PER_TICK, robot]
    ahead, left = np.meshgrid(HEIGHT_MAP_X, HEIGHT_MAP_Y, indexing="ij")
    grid = np.stack([ahead.ravel(), left.ravel(), -MAP_HEIGHT - film.maps[tick, robot]], axis=1)
    yaw = Rotation.from_quat(pose[3:7], scalar_first=True).as_euler("ZYX")[:1]
    points = pose[:3] + Rotation.from_euler("z", yaw).apply(grid)
    wrong = np.abs(points[:, 2] - painter.heights(points)) / WRONG
    colours = np.array(rgb(STATES[state][0])) * (1 - np.clip(wrong, 0, 1))[:, None]
    draw, ground = ImageDraw.Draw(image), view.ground
    for (x, y, scale), colour in zip(view.pixels(points), colours.astype(int), strict=True):
        column, row, size = int(x), int(y), DOT * scale
        inside = 0 <= row < ground.shape[0] and 0 <= column < ground.shape[1]
        if inside and ground[row, column]:
            draw.ellipse((x - size, y - 0.6 * size, x + size, y + 0.6 * size), tuple(colour))


def _stamp(image: Image.Image, trace: Trace, step: int, robot: int, title: str, fault: str) -> None:
    """Put texts and the depth image that the robot gets on a picture."""
    failing = trace.failing[step, robot]
    draw = ImageDraw.Draw(image, "RGBA")
    width, height = image.size
    state = _state(trace, step, robot)
    colour = rgb(STATES[state][0])
    draw.rectangle((0, 0, width, 24), fill=SHADE)
    draw.text((8, 4), title, font=_font(14), fill=WHITE)
    draw.rectangle((width - 92, 0, width, 24), fill=colour)
    ink = SHADE[:3] if sum(colour) > 380 else WHITE
    draw.text((width - 8, 4), state, font=_font(14), fill=ink, anchor="ra")
    depth = Image.fromarray(trace.film.images[step // STEPS_PER_TICK, robot])  # type: ignore[union-attr]
    draw.rectangle((width - 106, 32, width - 7, 107), fill=RED if failing else GREEN)
    image.paste(depth.resize((96, 72), Image.Resampling.NEAREST), (width - 104, 34))
    draw.rectangle((0, height - 22, width, height), fill=SHADE)
    pace = f"{trace.travelled[step, robot]:.1f} m, {trace.speed[step, robot]:.1f} m/s"
    draw.text((8, height - 19), pace, font=_font(13), fill=WHITE)
    words, colour = (fault, RED) if failing else ("camera healthy", GREEN)
    draw.text((width - 8, height - 19), words, font=_font(13), fill=colour, anchor="ra")
