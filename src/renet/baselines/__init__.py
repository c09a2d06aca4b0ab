"""Other answers to the same question, small and readable, run by the same studies."""
