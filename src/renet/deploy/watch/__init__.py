"""Checks of a robot's readings and of its motors while it runs."""
