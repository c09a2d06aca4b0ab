"""The depth camera and the scanners of terrain that it shares with other sensors."""
