"""Rows and results of the benchmark, made up."""

import hashlib

from renet.evaluation.benchmark.scores import score_rows


def row(episode, crossed, obstacles=2, entry="memory", **others):
    return {
        "entry": entry,
        "episode": episode,
        "family": "mount" if episode % 2 else "dark",
        "lie": bool(episode % 2),
        "fault": "turned" if episode % 2 else "blackout",
        "stranger": episode % 5 == 4,
        "obstacles": obstacles,
        "crossed": crossed,
        "fell": crossed < obstacles,
        "arrived": crossed == obstacles,
        "seconds": 10.0,
        "metres": 5.0,
        "joules": 1000.0,
        "peak_torque": 30.0,
        "speed_error": 0.1,
    } | others


def result(crossed, name="ours", method=None, entry="memory", episodes="quick"):
    """A result whose episodes have so many obstacles crossed, of two each."""
    rows = [row(i, c, entry=entry) for i, c in enumerate(crossed)]
    sha256 = hashlib.sha256(name.encode()).hexdigest()
    return {
        "benchmark": "renet-faults",
        "version": 3,
        "episodes": episodes,
        "policy": {"name": name, "method": method or name, "robot": "Go1", "sha256": sha256},
        "provenance": {"renet": "0", "commit": None, "engine": "native", "command": "", "date": ""},
        "scores": {entry: score_rows(rows)},
        "rows": rows,
    }
