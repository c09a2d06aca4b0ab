"""Other methods for the same problem, to compare RENet with in the same studies."""
