"""mjlab's simulation on C MuJoCo: many environments, stepped on threads of a CPU."""
