"""Depth cameras of a controller; `base` defines their interface."""
