"""Robots a controller can drive; `base` is the interface, `mujoco` and `go1` are drivers."""
