"""Robots a controller can drive: `driver` is the interface, `sim`, `go1` and `go2` implement it."""
