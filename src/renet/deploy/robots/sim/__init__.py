"""Robots simulated in this process."""
