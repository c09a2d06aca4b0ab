"""Colours of a robot's three states, and of ground that it has not seen.

Timelines, films, figures and the page share them. They are from Okabe and Ito's set, which
colour-blind people can tell apart.
"""

SEES_COLOUR = "#0072b2"
"""Colour of a robot that VP drives with images."""
REMEMBERS_COLOUR = "#e69f00"
"""Colour of a robot that VP drives from memory."""
BLIND_COLOUR = "#8c4a8c"
"""Colour of a robot that OP drives."""
STATES = {
    "sees": (SEES_COLOUR, "sees (VP)"),
    "remembers": (REMEMBERS_COLOUR, "remembers (VP)"),
    "blind": (BLIND_COLOUR, "blind (OP)"),
}
"""Colour and legend of each state."""
UNSEEN_COLOUR = "#d55e00"
"""Colour of ground that a robot without images has not seen."""
UNSEEN_AHEAD = "unseen ahead"
"""Words on a robot whose command leads to such ground."""


def rgb(colour: str) -> tuple[int, int, int]:
    """Return red, green and blue of `#rrggbb`, from 0 to 255."""
    return tuple(bytes.fromhex(colour[1:]))  # type: ignore[return-value]


def ink(colour: str) -> str:
    """Return the colour of text on `#rrggbb`: black or white, whichever stands out more."""
    light = luminance(colour)
    # Contrast by the Web Content Accessibility Guidelines, 2.1.
    on_white = 1.05 / (light + 0.05)
    on_black = (light + 0.05) / 0.05
    return "#ffffff" if on_white > on_black else "#000000"


def luminance(colour: str) -> float:
    """Return the relative luminance of `#rrggbb` in sRGB, from 0 (black) to 1 (white)."""
    linear = []
    for value in rgb(colour):
        share = value / 255
        linear.append(share / 12.92 if share <= 0.04045 else ((share + 0.055) / 1.055) ** 2.4)
    red, green, blue = linear
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue
