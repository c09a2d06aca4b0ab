"""Packages that add tasks, robots, cameras and devices: modules of entry points."""

import sys
from importlib.metadata import entry_points

TASKS = "mjlab.tasks"
"""Group of entry points under which packages register tasks, and with them robots."""
REGISTRY = "renet.registry"
"""renet's own entry point there, which needs PyTorch."""
ROBOTS = "renet.robots"
"""Group of entry points under which packages describe robots, and add drivers, cameras and devices
to the tables of `renet.deploy.catalogue`."""


def load_plug_ins(group: str) -> None:
    """Import the modules of other packages in a group; a line tells of one that fails."""
    for entry in entry_points(group=group):
        if entry.value == REGISTRY:
            continue
        try:
            entry.load()
        # The command may not need the package that fails.
        except Exception as error:
            print(f"renet: cannot use {entry.value}: {error}", file=sys.stderr)
