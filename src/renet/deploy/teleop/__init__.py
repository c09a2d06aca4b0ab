"""Operators' devices: `base` defines their interface."""
