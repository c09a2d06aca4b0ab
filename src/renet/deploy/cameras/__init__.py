"""Depth cameras a controller can look through; `base` is the interface."""
