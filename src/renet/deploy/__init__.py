"""How it reaches a robot: bundle, policy, observation. NumPy and ONNX Runtime only."""
