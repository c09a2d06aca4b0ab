"""Whose readings arrive, and in which order."""

import pytest

from renet.deploy.robots.real.identity import CONFUSED, MOST_ODD_COUNTS, RESTARTED, Count, Speakers

LEAP = 100


def news(*counts: int) -> tuple[list[bool], str]:
    """What is said of counts one after the other, and the problem at the end."""
    count = Count(LEAP)
    said = [count.news(one % 2**32) for one in counts]
    return said, count.problem


@pytest.mark.parametrize("last", [1000, 2**32 - 2])
def test_a_count_that_is_not_newer_is_no_news(last):
    """It has 32 bits and goes on from zero."""
    for step, newer in ((0, False), (-1, False), (-LEAP, False), (1, True), (LEAP, True)):
        assert news(last, last + step) == ([True, newer], "")


@pytest.mark.parametrize("bit", range(8, 32))
def test_one_flipped_bit_costs_one_reading(bit):
    counts = [4_000_000 + 2 * n for n in range(50)]
    counts[20] ^= 1 << bit
    said, problem = news(*counts)
    assert said == [n != 20 for n in range(50)]
    assert problem == ""


def test_a_silence_is_gone_on_from():
    counts = [*range(0, 20, 2), *range(5000, 5020, 2)]
    said, problem = news(*counts)
    assert said == [True] * 10 + [False] * 2 + [True] * 8
    assert problem == ""


def test_a_robot_that_was_started_again_is_none_to_go_on_with():
    said, problem = news(*range(50_000, 50_020, 2), *range(0, 20, 2))
    assert not any(said[10:])
    assert problem == RESTARTED


def test_two_robots_whose_readings_take_turns_are_told():
    pairs = [(1000 + 2 * n, 90_000 + 700 * n) for n in range(2 * MOST_ODD_COUNTS)]
    said, problem = news(*(one for pair in pairs for one in pair))
    assert problem == CONFUSED
    assert not any(said[1::2]), "the other one is never believed"


def test_flipped_bits_now_and_then_are_forgiven():
    counts = [2 * n for n in range(20_000)]
    for n in range(100, 20_000, 200):
        counts[n] ^= 1 << 30
    assert news(*counts)[1] == ""


def test_only_the_one_that_was_heard_first_counts():
    speakers = Speakers()
    assert speakers.hear("mine")
    speakers.pin()
    assert speakers.hear("mine")
    assert not speakers.intruded
    assert not speakers.hear("another")
    assert speakers.intruded


def test_several_cannot_be_pinned():
    speakers = Speakers()
    assert speakers.hear("mine")
    assert speakers.hear("another")
    assert len(speakers) == 2
    with pytest.raises(ValueError):  # noqa: PT011
        speakers.pin()
