"""mjlab's simulation on C MuJoCo, with many environments on the threads of a CPU."""
