"""Robots that a controller drives: `base` is the interface; `sim`, `go1` and `go2` implement it."""
