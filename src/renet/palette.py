"""Colours of a robot's three states in timelines, films, figures and on the page.

They are from Okabe and Ito's set, which colour-blind people can tell apart.
"""

SEES, REMEMBERS, BLIND = "#0072b2", "#e69f00", "#8c4a8c"
"""VP drives with images; VP drives from memory; OP drives."""
STATES = {
    "sees": (SEES, "sees (VP)"),
    "remembers": (REMEMBERS, "remembers (VP)"),
    "blind": (BLIND, "blind (OP)"),
}
"""Colour and legend of each of the selector's states."""


def rgb(colour: str) -> tuple[int, int, int]:
    """Red, green and blue of `#rrggbb`, 0 to 255."""
    return tuple(bytes.fromhex(colour[1:]))  # type: ignore[return-value]
