"""The fault benchmark, renet-faults, version 3 (docs/benchmark.md).

`episodes` draws what is walked, `families` the faults, `walking` lets robots walk it, `scores`
counts, `results` reads and writes files, `leaderboard` ranks them, `study` is the command.
"""
