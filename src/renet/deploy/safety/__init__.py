"""The safety layer: when a robot may move, and how far one command may go."""
