"""renet: quadruped locomotion that survives the loss of its depth camera (RENet)."""

__version__ = "0.1.0"
