"""The fault benchmark, renet-faults, version 3 (docs/benchmark.md).

`episodes` draws courses, commands and faults, `families` lists the faults, `walking` simulates the
robots, `scores` counts obstacles, `results` reads and writes result files, `leaderboard` ranks
them, and `study` is the command.
"""
