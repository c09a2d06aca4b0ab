"""Runs a bundle on a robot, real or simulated; the extra `sim` is for a simulated one."""
