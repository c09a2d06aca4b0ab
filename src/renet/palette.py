"""Colours of a robot's three states in timelines, films, figures and on the page.

They are from Okabe and Ito's set, which colour-blind people can tell apart.
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


def rgb(colour: str) -> tuple[int, int, int]:
    """Return red, green and blue of `#rrggbb`, from 0 to 255."""
    return tuple(bytes.fromhex(colour[1:]))  # type: ignore[return-value]
