"""Safety layer: conditions under which a robot may move, and the limits of its commands."""
