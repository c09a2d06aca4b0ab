"""Measures a robot's motors: fits MuJoCo's model of them to a log of its joints."""
