"""The page "Break its camera": a bundle, the Go1 and its camera in the visitor's browser."""
