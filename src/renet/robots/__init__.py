"""Robots: one description each, from which tasks, simulators and drivers are derived.

A bundle brings its policy's joints, gains and camera. A description also holds what no bundle may
decide: the model of the body, and the limits of its motors.
"""

from renet.robots.go1 import GO1
from renet.robots.go2 import GO2
from renet.robots.robot import Motor, Robot, find_robot, register_robot, robots

__all__ = ["GO1", "GO2", "Motor", "Robot", "find_robot", "register_robot", "robots"]
