"""Simulation: the native CPU engine, the depth camera and terrain sensors."""

import os
from contextlib import suppress

# The import of mjlab loads renet.registry, which imports modules of this package. It must come
# first, or one of them would be initialised only in part. The ray caster works without mjlab.
with suppress(ModuleNotFoundError):
    import mjlab  # noqa: F401


def _start_warp_silently() -> None:
    """Initialise Warp without its messages on loaded modules and a missing GPU."""
    import warp

    warp.config.log_level = warp.LOG_WARNING
    # Warp's C++ part writes to the file descriptor 2 rather than to sys.stderr.
    stderr = os.dup(2)
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 2)
    try:
        warp.init()
    finally:
        os.dup2(stderr, 2)
        os.close(stderr)
        os.close(null)


with suppress(ModuleNotFoundError):
    _start_warp_silently()
