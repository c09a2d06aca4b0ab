"""Courses: where obstacles lie, and what rays from above meet."""

import math

import mujoco
import numpy as np
import pytest

from renet.terrain.course import (
    COURSE_WIDTH,
    GROUND_BEFORE,
    PIT_DEPTH,
    Blocks,
    Course,
    Gap,
    Platform,
    Ramp,
    Stairs,
)
from renet.terrain.tiles import OBSTACLE_GROUP

UP = Stairs(0.1, 0.3, 4)
DOWN = Stairs(-0.2, 0.25, 3)
COURSE = Course(obstacles=(Gap(0.6), UP, DOWN), spaces=(2.0, 1.0, 0.5))


def scene(course):
    spec = mujoco.MjSpec()
    spec.worldbody.add_body(name="terrain")
    course.size = (course.length, COURSE_WIDTH)
    course.function(0.0, spec, np.random.default_rng(99))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def heights(course, positions, aside=0.0):
    """Of the highest surface at positions along a course, by MuJoCo's own rays."""
    model, data = scene(course)
    found = []
    for position in positions:
        above = np.array([GROUND_BEFORE + position, COURSE_WIDTH / 2 + aside, 9.0])
        ray = np.array([0.0, 0.0, -1.0])
        far = mujoco.mj_ray(model, data, above, ray, None, 1, -1, np.zeros(1, np.int32))
        found.append(9.0 - far)
    return np.array(found)


def test_obstacles_follow_one_another():
    np.testing.assert_allclose(COURSE.edges, [(2.0, 2.6), (3.6, 4.8), (5.3, 6.05)])
    assert COURSE.length == pytest.approx(GROUND_BEFORE + 6.05 + 2.5)


def test_heights_add_up():
    np.testing.assert_allclose(
        heights(COURSE, (-0.5, 1.9, 2.3, 3.0, 3.7, 4.7, 5.0, 5.4, 6.0, 8.0)),
        (0.0, 0.0, -PIT_DEPTH, 0.0, 0.1, 0.4, 0.4, 0.2, -0.2, -0.2),
        atol=1e-6,
    )


def test_feet_walk_on_a_line_over_the_gap():
    where = np.array((0.0, 2.3, 4.2, 5.0, 6.05, 9.0))
    np.testing.assert_allclose(
        COURSE.walking_height(where), (0.0, 0.0, 0.2, 0.4, -0.2, -0.2), atol=1e-9
    )


def test_platform_and_ramp_have_their_sizes():
    course = Course(obstacles=(Platform(0.4, 1.0), Ramp(20.0, 1.0)), spaces=(1.0, 1.0))
    top = math.tan(math.radians(20.0))
    np.testing.assert_allclose(
        heights(course, (0.9, 1.5, 2.1, 3.5, 4.3, 5.1, 5.8)),
        (0.0, 0.4, 0.0, top / 2, top, top / 2, 0.0),
        atol=1e-6,
    )


@pytest.mark.parametrize("aside", [-5.9, 5.9])
def test_nobody_walks_around_an_obstacle(aside):
    assert heights(COURSE, [2.3], aside) == pytest.approx(-PIT_DEPTH)


def test_blocks_are_the_same_beside_any_course():
    field = Course(obstacles=(Blocks(0.2, 1.5),), spaces=(1.0,), seed=4)
    longer = Course(obstacles=(Blocks(0.2, 1.5), Gap(0.3)), spaces=(1.0, 1.0), seed=4)
    where = np.linspace(1.0, 2.5, 40)
    first = heights(field, where)
    np.testing.assert_array_equal(first, heights(longer, where))
    assert first.max() > 0.1
    other = Course(obstacles=(Blocks(0.2, 1.5),), spaces=(1.0,), seed=5)
    assert (heights(other, where) != first).any()


def test_only_what_stands_on_the_ground_can_be_glass():
    model, _ = scene(Course(obstacles=(Gap(0.5), UP), spaces=(1.0, 1.0)))
    glass = model.geom_group == OBSTACLE_GROUP
    assert glass.sum() == UP.steps
    assert (model.geom_pos[glass, 0] > GROUND_BEFORE + 2.5).all()


def test_a_record_has_kind_and_sizes():
    assert UP.record() == {"kind": "stairs", "rise": 0.1, "tread": 0.3, "steps": 4}


def test_spaces_must_match():
    with pytest.raises(ValueError, match="1 obstacles need as many spaces"):
        Course(obstacles=(UP,), spaces=())
