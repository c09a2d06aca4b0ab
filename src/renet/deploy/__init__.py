"""Runs a bundle on a robot, real or simulated; NumPy and ONNX Runtime are enough for a real one."""
