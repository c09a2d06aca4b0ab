"""Films: what their pictures show of ground that a robot has not seen."""

from dataclasses import replace

import mujoco
import numpy as np

from renet.evaluation import painter
from renet.evaluation.trace import Film, Trace
from renet.evaluation.video import pictures
from renet.interface import HEIGHT_MAP_SIZE, MAP_HEIGHT
from renet.palette import REMEMBERS_COLOUR, UNSEEN_COLOUR, rgb

from .fakes import SCENE

STEPS = 5
"""Control steps of one vision tick."""


def remembering(
    maps_seen: np.ndarray, unseen: bool, height: float = MAP_HEIGHT, map_height: float = MAP_HEIGHT
) -> Trace:
    """A robot without images on flat ground, its base at a height, m, and its map all zeros."""
    trace = Trace.empty(STEPS, 1)
    trace.vision[:] = True
    trace.unseen[:] = unseen
    poses = np.zeros((STEPS, 1, 7))
    poses[:, :, 2] = height
    poses[:, :, 3] = 1.0
    images = np.zeros((1, 1, 48, 64), np.uint8)
    maps = np.zeros((1, 1, HEIGHT_MAP_SIZE))
    return replace(trace, film=Film(poses, images, maps, maps_seen[None, None], map_height))


def picture(trace: Trace, fault: str = "black") -> np.ndarray:
    """Draw the first picture of a trace's film, [height, width, 3]."""
    scene = mujoco.MjSpec.from_string(SCENE)
    return next(pictures(scene, trace, {0: "memory"}, fault, steps=[0]))


def count(picture: np.ndarray, colour: str) -> tuple[int, int]:
    """Pixels of a colour on the ground, and in the lower left corner where words are."""
    near = np.abs(picture.astype(int) - rgb(colour)).max(axis=2) < 8
    words = np.zeros_like(near)
    words[painter.PANEL[1] - 60 : painter.PANEL[1] - 30, :151] = True
    ground = ~words
    ground[:31] = False
    return int(near[ground].sum()), int(near[words].sum())


def test_unseen_ground_has_a_colour_of_its_own():
    everything = np.ones(HEIGHT_MAP_SIZE, bool)
    seen = picture(remembering(everything, unseen=False))
    assert count(seen, REMEMBERS_COLOUR)[0] > 1000
    assert count(seen, UNSEEN_COLOUR) == (0, 0)

    nothing = picture(remembering(~everything, unseen=False))
    assert count(nothing, UNSEEN_COLOUR)[0] >= count(seen, REMEMBERS_COLOUR)[0]
    assert count(nothing, REMEMBERS_COLOUR)[0] == 0


def test_a_robot_that_walks_towards_it_says_so():
    everything = np.ones(HEIGHT_MAP_SIZE, bool)
    ground, words = count(picture(remembering(everything, unseen=True)), UNSEEN_COLOUR)
    assert ground == 0
    assert words > 1000


def test_the_map_of_a_taller_robot_lies_on_the_ground():
    """Its map is zero where the ground is 38 cm below the base; dots in the air are darker."""
    everything = np.ones(HEIGHT_MAP_SIZE, bool)
    on_ground = remembering(everything, unseen=False, height=0.38, map_height=0.38)
    assert count(picture(on_ground), REMEMBERS_COLOUR)[0] > 1000
    in_air = remembering(everything, unseen=False, height=0.38)
    assert count(picture(in_air), REMEMBERS_COLOUR)[0] == 0


def test_the_names_of_several_faults_leave_distance_and_speed_legible():
    trace = remembering(np.ones(HEIGHT_MAP_SIZE, bool), unseen=False)
    trace.failing[:] = True
    trace.travelled[:] = 12.3
    trace.forward_velocity[:] = -0.5
    pace = np.s_[painter.PANEL[1] - 30 :, :160]
    short = picture(trace)
    long = picture(trace, "intermittent_blackout, salt_and_pepper, floor_reflection")
    np.testing.assert_array_equal(short[pace], long[pace])
    assert (short != long).any()
