"""Whether a robot's readings are true, and whether its motors do what they are told."""
