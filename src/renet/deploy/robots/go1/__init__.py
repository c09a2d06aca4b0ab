"""The Unitree Go1."""
