"""What it runs on: the native CPU engine, the depth camera and terrain sensors."""

import os
from contextlib import suppress

# Importing mjlab loads renet.registry, which needs this package's modules: begin there, or one
# of them would be met half-initialised. The ray caster alone works without mjlab.
with suppress(ModuleNotFoundError):
    import mjlab  # noqa: F401


def _start_warp_silently() -> None:
    """Keep Warp from printing a line for each module it loads, or for want of a GPU."""
    import warp

    warp.config.log_level = warp.LOG_WARNING
    # Its C++ part writes to the file descriptor.
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
