"""Parkour tiles, in plain MuJoCo."""
