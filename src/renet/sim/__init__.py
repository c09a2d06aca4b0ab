"""Simulation: the native CPU engine, the depth camera and terrain sensors."""

import os
from contextlib import suppress

# mjlab's import loads renet.registry, which imports this package's modules. It must come first, or
# one of them would be half-initialised. The ray caster alone works without mjlab.
with suppress(ModuleNotFoundError):
    import mjlab  # noqa: F401


def _start_warp_silently() -> None:
    """Initialise Warp without its lines on each module it loads and on a missing GPU."""
    import warp

    warp.config.log_level = warp.LOG_WARNING
    # Warp's C++ part writes to the file descriptor.
    stderr, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        warp.init()
    finally:
        os.dup2(stderr, 2)
        os.close(stderr)
        os.close(nowhere)


with suppress(ModuleNotFoundError):
    _start_warp_silently()
