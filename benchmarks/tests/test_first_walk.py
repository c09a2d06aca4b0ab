"""The README's first commands: who crosses, and a command that fails."""

import subprocess
from pathlib import Path
from types import SimpleNamespace

import pytest

import first_walk
from first_walk import CROSSED, Cfg, summarise, walk
from renet.errors import RenetError


def score(mode: str, seed: int, end: str) -> dict:
    run = {"mode": mode, "seed": seed, "bundle": "go1", "bundle_sha256": "abc"}
    return {"run": run, "crossed": end, "falls": 0, "distance_m": 1.0, "states": ["sees"]}


def test_who_crosses_is_counted_by_mode():
    ends = (("switch", 1, "fell into the gap"), ("switch", 2, CROSSED))
    ends += (("memory", 1, CROSSED), ("memory", 2, CROSSED))
    summary = summarise([score(*end) for end in ends])
    assert summary["crossed"] == {"switch": 1, "memory": 2}
    assert summary["seeds"] == 2
    assert [run["seed"] for run in summary["runs"]] == [1, 2, 1, 2]


def test_the_command_writes_the_score_that_is_counted(tmp_path, monkeypatch):
    """A second of the real command: it ends before the robot walks."""
    monkeypatch.setattr(first_walk, "COMMAND", f"{first_walk.COMMAND} --seconds 1")
    walked = walk("memory", 3, tmp_path / "walk")
    assert (walked["run"]["mode"], walked["run"]["seed"]) == ("memory", 3)
    assert summarise([walked])["crossed"] == {"switch": 0, "memory": 0}


def test_a_command_that_fails_is_named(monkeypatch):
    failed = SimpleNamespace(returncode=2, stderr=b"renet: no such bundle\n")
    monkeypatch.setattr(subprocess, "run", lambda *arguments, **options: failed)
    with pytest.raises(RenetError, match=r"--mode memory --seed 1 failed: renet: no such bundle"):
        walk("memory", 1, Path("nowhere"))
    with pytest.raises(RenetError, match="seeds must be at least 1"):
        first_walk.main(Cfg(seeds=0))
