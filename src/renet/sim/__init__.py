"""What it runs on: the native CPU engine, the depth camera and terrain scans."""

from contextlib import suppress

# Importing mjlab loads renet.tasks, which needs this package's modules: begin there, or one of them
# would be met half-initialised. The ray caster alone works without mjlab.
with suppress(ModuleNotFoundError):
    import mjlab  # noqa: F401
