"""Colours: text on each of them can be read."""

import pytest

from renet.palette import STATES, UNSEEN_COLOUR, ink, luminance


def contrast(one: str, other: str) -> float:
    """Contrast of the Web Content Accessibility Guidelines, from 1 to 21."""
    dark, light = sorted((luminance(one), luminance(other)))
    return (light + 0.05) / (dark + 0.05)


def test_contrast_is_that_of_the_guidelines():
    """Black on white, and the lightest greys on white that pass levels AA and AAA."""
    assert contrast("#000000", "#ffffff") == pytest.approx(21.0)
    assert contrast("#767676", "#ffffff") == pytest.approx(4.54, abs=0.005)
    assert contrast("#595959", "#ffffff") == pytest.approx(7.0, abs=0.005)


@pytest.mark.parametrize("colour", [*(colour for colour, _ in STATES.values()), UNSEEN_COLOUR])
def test_text_on_every_colour_can_be_read(colour):
    assert contrast(colour, ink(colour)) >= 4.5
